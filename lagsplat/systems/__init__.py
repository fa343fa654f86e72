"""Simulated mechanisms whose truth is known: the arms, their inputs, their pictures."""
