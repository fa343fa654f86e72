"""Motions whose law is known: linear mechanisms by exact matrix exponentials."""

import numpy as np
from scipy.linalg import expm

from lagsplat.io.trajectory.trajectory import Trajectory

PERIOD_S = 1.1


def swing(
    *,
    seconds: float = 15.0,
    rate_hz: float = 60.0,
    period_s: float = PERIOD_S,
    damping: float = 0.03,
    start: tuple[float, ...] = (1.0,),
    noise: float = 0.01,
    seed: int = 0,
    drive: np.ndarray | None = None,
    gain: float = 20.0,
    source: str = "motion.csv",
) -> Trajectory:
    """``a = -w^2 q - 2 damping w v + gain u``, held inputs, noise in units of the rms of each coordinate.

    A start of two numbers makes two uncoupled coordinates, the second 1.7 times as fast.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds * rate_hz)
    u = np.zeros(n) if drive is None else drive
    columns = []
    for i, q0 in enumerate(start):
        w = 2.0 * np.pi / period_s * 1.7**i
        law = np.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * damping * w, gain], [0.0, 0.0, 0.0]])
        step = expm(law / rate_hz)[:2]
        state, seen = np.array([q0, 0.0]), []
        for value in u:
            seen.append(state[0])
            state = step @ np.array([*state, value])
        columns.append(np.array(seen))
    q = np.stack(columns, axis=1)
    q = q + noise * q.std(axis=0) * rng.normal(size=q.shape)
    inputs = np.zeros((n, 0)) if drive is None else u[:, None]
    return Trajectory(time_s=np.arange(n) / rate_hz, q=q, u=inputs, source=source)


def multisine(n: int, *, rate_hz: float = 60.0, seed: int = 0) -> np.ndarray:
    """Five lines between 0.1 and 2.2 Hz with phases of their own."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) / rate_hz
    lines = zip(rng.uniform(0.1, 2.2, 5), rng.uniform(0.0, 2.0 * np.pi, 5), strict=True)
    return sum((np.sin(2.0 * np.pi * f * time + phase) for f, phase in lines), np.zeros(n)) / 2.0


def glued(*motions: Trajectory, rate_hz: float = 60.0) -> Trajectory:
    """Motions written one after another as if nothing had happened in between."""
    q = np.concatenate([motion.q for motion in motions])
    u = np.concatenate([motion.u for motion in motions])
    return Trajectory(time_s=np.arange(len(q)) / rate_hz, q=q, u=u, source="glued.csv")
