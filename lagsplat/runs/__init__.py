"""A fitted run: made from a recording in one process, opened again, and simulated.

Public: `fit.fit_run`, `run.open_run`, `run.FittedRun`, `run.rollout`.
"""
