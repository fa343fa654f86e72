"""Simulated mechanisms with known truth: the seven systems of the paper, their inputs and their videos."""
