"""Recordings of a cart on a spring with one thing changed, made by an integrator of SciPy."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

STEP_S, SPAN_S = 1.0 / 60.0, 8.0


def drive(t: np.ndarray | float, phase: float) -> np.ndarray | float:
    """A force of three lines."""
    return np.sin(3.1 * t + phase) + 0.8 * np.sin(7.3 * t) + 0.6 * np.sin(5.2 * t + 2.0 * phase)


def move(
    *,
    rate: float = 0.3,
    stiffness: float = 36.0,
    gain: float = 4.0,
    extra: Callable[[float, float], float] = lambda q, v: 0.0,
    phase: float = 0.3,
) -> np.ndarray:
    """Columns t, q0, u0 of ``a = -stiffness q - rate v + gain u + extra(q, v)``."""
    t = np.arange(0.0, SPAN_S, STEP_S)
    u = drive(t, phase)

    def slope(s: float, x: np.ndarray) -> list[float]:
        force = gain * np.interp(s, t, u) - stiffness * x[0] - rate * x[1]
        return [x[1], force + extra(x[0], x[1])]

    path = solve_ivp(slope, (0.0, t[-1]), [0.2, 0.0], t_eval=t, rtol=1e-8, atol=1e-9, max_step=STEP_S)
    return np.column_stack([t, path.y[0], u])


def save(place: Path, name: str, columns: np.ndarray, *, noise: float, seed: int) -> None:
    """Write the columns as CSV, ``noise`` of the rms added to q0."""
    place.mkdir(parents=True, exist_ok=True)
    shown = columns.copy()
    rng = np.random.default_rng(seed)
    shown[:, 1] += noise * shown[:, 1].std() * rng.standard_normal(len(shown))
    np.savetxt(place / name, shown, fmt="%.9g", delimiter=",", header="t,q0,u0", comments="")


def recording(place: Path, real: np.ndarray, *, noise: float = 0.003) -> Path:
    """A folder of a nominal recording and a real one."""
    save(place, "sim_0.csv", move(phase=1.1), noise=noise, seed=1)
    save(place, "real_0.csv", real, noise=noise, seed=2)
    return place
