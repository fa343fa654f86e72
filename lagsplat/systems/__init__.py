"""Simulated mechanisms with known truth: the seven systems of the paper, their inputs and their videos.

`simulate` makes a recording (`simulate_system`), `arm` and `mechanism` hold the equations of motion, `truth`
what a fitted law is compared with (`Truth`), and `rendering` renders the frames.
"""
