"""Where the Lagrangian starts: its unit of time, and a start that has not seen the data."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.chart.trajectory import Trajectory
from lagsplat.stage2.lagrangian import Coefficients
from lagsplat.stage2.windows import starts_of


def natural_time_unit(
    trajectory: Trajectory, metric: Float[np.ndarray, "d d"], *, stride_frames: int
) -> float:
    """Ratio of the rms velocity to the rms acceleration in the metric [s]: about a period over 2 pi.

    From differences over ``stride_frames`` by their true times. The ratio of position to velocity would be
    the same for a free oscillation, but a slow drive lengthens it to the drive's own time, several times
    that of the mechanism.

    Raises:
        ValueError: the latents do not move.
    """
    k = stride_frames
    at = starts_of(trajectory, before=k, after=k)
    q, clock = trajectory.latents, trajectory.clock
    # in strides of the median step, of which the ratio is a number
    before, after = (clock.elapsed_s(at, ahead) / (k * clock.dt_s) for ahead in (-k, k))
    moved = clock.slope(q, at, (-k, k)) * (k * clock.dt_s)
    bent = 2.0 * ((q[at + k] - q[at]) / after - (q[at - k] - q[at]) / before) / (after - before)
    speed, change = (float(np.einsum("ti,ij,tj->", x, metric, x)) for x in (moved, bent))
    if not change > 0.0:
        raise ValueError("the latents of the training clip do not move: there is no dynamics to learn")
    return float(np.sqrt(speed / change)) * k * trajectory.dt_s


def isotropic(d: int, n_inputs: int, *, damping: float, stiffness: float, rest: Tensor) -> Coefficients:
    """Multiples of the identity, for comparison with a start that has seen the data."""
    eye = torch.eye(d, dtype=torch.float64)
    return Coefficients(
        eye, damping * eye, stiffness * eye, torch.zeros(n_inputs, d, dtype=torch.float64), rest
    )
