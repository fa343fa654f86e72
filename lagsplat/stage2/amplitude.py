"""The frequency of a law at the smallest amplitude that a recording holds, beside that at rest.

A frequency depends on the amplitude where springs are not linear. Motion that is smaller than all that a
recording shows, a law extrapolates.
"""

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.equilibrium import NoEquilibriumError, find_equilibrium
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.rollout import rollout

PERIODS = 6  # of a rollout, over which a frequency is measured


def measure_quietest_frequency(
    law: Lagrangian, trajectory: EncodedTrajectory, *, period_frames: int
) -> float | None:
    """Frequency [Hz] at which a law with one coordinate goes on from the smallest swing of a free motion.

    Args:
        law: With one coordinate.
        trajectory: Smoothed, so that noise is no swing.
        period_frames: Length of a swing.

    Returns:
        None for several coordinates, inputs that change, clips shorter than a swing, or a law that creeps
        or has no equilibrium.
    """
    inputs = trajectory.inputs
    if law.d != 1 or (inputs.size and np.ptp(inputs, axis=0).max() > 0.0):
        return None
    swings = [
        trajectory.latents[start : start + period_frames]
        for first, stop in trajectory.segments
        for start in range(first, stop - period_frames + 1, period_frames)
    ]
    if not swings:
        return None
    quietest = min(swings, key=lambda swing: float(np.ptp(swing)))
    u = torch.from_numpy(inputs[:1])
    try:
        rest = find_equilibrium(law, u[0])
    except NoEquilibriumError:
        return None
    away = torch.from_numpy(quietest) - rest
    start = rest + away[away.abs().argmax()]
    n = PERIODS * period_frames
    states, _ = rollout(
        law, start[None], torch.zeros_like(start[None]), u.expand(1, n, -1), dt_s=trajectory.dt_s
    )
    return count_oscillations((states[0, :, 0] - rest).detach().numpy(), dt_s=trajectory.dt_s)


def count_oscillations(x: Float64[np.ndarray, " N"], *, dt_s: float) -> float | None:
    """Frequency [Hz] from the first to the last rise through zero, interpolated; None for fewer than two."""
    rises = np.flatnonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))
    if len(rises) < 2:
        return None
    at = rises + x[rises] / (x[rises] - x[rises + 1])
    return float((len(rises) - 1) / ((at[-1] - at[0]) * dt_s))
