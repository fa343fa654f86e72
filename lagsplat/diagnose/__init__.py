"""Why a simulation and a recording disagree: where the gap lies, what causes it, and how far it closes.

`diagnosis` has `diagnose`, from a simulator and real trajectories to a verdict with its evidence. The
packages below it follow the data: data quality, residual, effects, estimation, identification, inference.
"""
