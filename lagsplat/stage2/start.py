"""Where the Lagrangian starts: its unit of time, and a start that has not seen the data."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.chart.trajectory import Trajectory
from lagsplat.stage2.lagrangian import Coefficients
from lagsplat.stage2.windows import starts_of


def natural_time_unit(trajectory: Trajectory, metric: Float[np.ndarray, "d d"]) -> float:
    """Ratio of the rms position to the rms velocity in the metric [s]: about a period over 2 pi.

    Raises:
        ValueError: the latents do not move.
    """
    at = starts_of(trajectory, before=1, after=1)
    q = trajectory.latents
    rate = (q[at + 1] - q[at - 1]) / (2.0 * trajectory.dt_s)
    offset = q[at] - q[at].mean(0)
    moved, speed = (float(np.einsum("ti,ij,tj->", x, metric, x)) for x in (offset, rate))
    if not speed > 0.0:
        raise ValueError("the latents of the training clip do not move: there is no dynamics to learn")
    return float(np.sqrt(moved / speed))


def isotropic(d: int, n_inputs: int, *, damping: float, stiffness: float, rest: Tensor) -> Coefficients:
    """Multiples of the identity, for comparison with a start that has seen the data."""
    eye = torch.eye(d, dtype=torch.float64)
    return Coefficients(
        eye, damping * eye, stiffness * eye, torch.zeros(n_inputs, d, dtype=torch.float64), rest
    )
