"""Simulate a fitted run beyond its recording, and score it on the held-out part.

python examples/02_rollout_and_score.py FOLDER [evaluate.key=value ...]
"""

import sys

import numpy as np

import lagsplat

folder, *changes = sys.argv[1:] or ["run"]
run = lagsplat.open_run(folder)

# Five seconds without inputs, from the state and velocity of the last training frame but one.
n = round(5.0 / run.chart.dt_s)
states, velocities = lagsplat.rollout(
    run, np.zeros((n, run.chart.inputs.shape[1])), frame=run.recording.n_train - 2
)
print(f"{n} steps of {run.chart.dt_s:.3f} s: from {states[0].round(2)} to {states[-1].round(2)}")
print(f"fastest coordinate: {np.abs(velocities).max():.2f} whitened units a second")

scores = lagsplat.evaluate(run, *changes)["scores"]
for name in sorted(scores):
    if isinstance(scores[name], float):
        print(f"{name:32}{scores[name]:.4g}")
