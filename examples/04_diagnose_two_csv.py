"""Compare trajectories of a simulator with those of the real mechanism, and name what the simulator lacks.

    python examples/04_diagnose_two_csv.py [FOLDER] [setting=number ...]

Here both are made: a pendulum, and one whose hinge rubs. In a CSV of your own: columns t, q0, ..., u0, ...
"""

import sys
from pathlib import Path

import numpy as np

import lagsplat

words = sys.argv[1:]
folder = Path(next((word for word in words if "=" not in word), "."))
settings = {word.split("=")[0]: int(word.split("=")[1]) for word in words if "=" in word}


def swing(friction: float, seed: int, n: int = 600, dt_s: float = 0.025) -> np.ndarray:
    """Columns t [s], q0 [rad], u0 [N m] of a driven pendulum with dry friction, and a little noise."""
    rng = np.random.default_rng(seed)
    t = dt_s * np.arange(n)
    u = sum(2.0 * np.sin(w * t + p) for w, p in zip((1.7, 3.1, 6.3), rng.uniform(0, 6, 3), strict=True))
    q, v, states = 0.3, 0.0, []
    for push in u:
        states.append(q)
        for _ in range(20):
            v += dt_s / 20 * (push - 16.0 * np.sin(q) - 0.3 * v - friction * np.tanh(100.0 * v))
            q += dt_s / 20 * v
    return np.stack([t, np.array(states) + 0.002 * rng.standard_normal(n), u], axis=1)


for name, friction, seed in (("sim", 0.0, 1), ("real", 0.6, 2)):
    rows = swing(friction, seed)
    np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header="t,q0,u0", comments="", fmt="%.9g")

diagnosis = lagsplat.diagnose(folder / "sim.csv", folder / "real.csv", out=folder / "diagnosis", **settings)
print(diagnosis)
for effect in diagnosis.effects:
    print(f"{effect.name}: {effect.probability:.0%}, {dict(effect.parameters)}")
print(f"error of held-out forecasts: {diagnosis.gap.before:.3f} before, {diagnosis.gap.after:.3f} after")
diagnosis.plot().savefig(folder / "candidates.png")
