"""Objectives of stage 2: forecast errors in the visibility metric, and a penalty that anchors the law."""

import copy
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latents, Metric, Scalar
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.rollout import (
    ShootingTargets,
    ShootingWindows,
    advance,
    choose_step,
    list_starts,
    verlet_step,
)


def add_ridge(metric: Metric, *, ridge: float) -> Metric:
    """Compute ``G + ridge lambda_max(G) I``, scaled to trace ``d``.

    The ridge caps the ratio of weights between two directions at about ``1 / ridge``, so that an invisible
    direction stays constrained.

    Source: paper eq. (physics_loss) and the text below it.
    """
    d = metric.shape[0]
    largest = torch.linalg.eigvalsh(metric)[-1]
    whole = metric + ridge * largest * torch.eye(d, dtype=metric.dtype)
    return whole * (d / torch.trace(whole))


def square_norm(error: Float[Tensor, "*B d"], metric: Metric) -> Float[Tensor, "*B"]:
    """Compute ``error . metric error``."""
    return ((error @ metric) * error).sum(-1)


def one_step_error(
    lagrangian: Lagrangian, windows: ShootingWindows, metric: Metric, *, velocity_weight: float
) -> Scalar:
    """Compute the mean error of one velocity-Verlet step, see `window_error`.

    Source: paper eq. (physics_loss).
    """
    ready = lagrangian.prepare()
    q, v = verlet_step(lagrangian, windows.q, windows.v, windows.u, step=windows.step, ready=ready)
    return window_error(windows, q, v, metric, velocity_weight=velocity_weight)


def window_error(
    windows: ShootingWindows, q: Latents, v: Latents, metric: Metric, *, velocity_weight: float
) -> Scalar:
    """Compute the mean error of forecasts ``q`` and ``v``: position plus velocity times the step."""
    position = square_norm(q - windows.q_next, metric)
    velocity = square_norm(windows.step * (v - windows.v_next), metric)
    return (position + velocity_weight * velocity).mean() / metric.shape[0]


def shooting_error(lagrangian: Lagrangian, shots: ShootingTargets, metric: Metric) -> Scalar:
    """Compute the mean position error of a rollout over all states after the first."""
    ready = lagrangian.prepare()
    q, v, path = shots.q, shots.v, []
    for i in range(shots.targets.shape[1] - 1):
        step = choose_step(shots.steps, i)
        q, v = advance(lagrangian, q, v, shots.inputs[:, i], step=step, ready=ready)
        path.append(q)
    return square_norm(torch.stack(path, 1) - shots.targets[:, 1:], metric).mean() / metric.shape[0]


REACH = 2.5
"""Spread of the sampled positions as a multiple of that of the clip, so that most lie outside its frames."""
DRAWN = 256  # sampled states per penalty


@dataclass(frozen=True)
class Anchor:
    """The law at the start of a descent, and the states at which later laws are compared with it.

    Frames do not constrain the networks just outside the clip, where a released mechanism comes to rest.
    There the starting law is the better guess, because its few coefficients were fitted to all frames. Among
    the frames the data outweigh it, see `anchored_error`.
    """

    start: Lagrangian
    inputs: Float[np.ndarray, "T n_u"]
    middle: Float[Tensor, " d"]
    spread: Float[Tensor, " d"]
    speed: Float[Tensor, " d"]  # rms, per internal time unit

    def penalty(self, lagrangian: Lagrangian, metric: Metric, rng: np.random.Generator) -> Scalar:
        """Compute the mean square difference between the accelerations of ``lagrangian`` and the start.

        Positions and velocities are normal samples, inputs are sampled from the clip.
        """
        draw = torch.from_numpy(rng.standard_normal((2, DRAWN, len(self.middle))))
        q = self.middle + REACH * self.spread * draw[0]
        v = self.speed * draw[1]
        u = torch.from_numpy(self.inputs[rng.integers(len(self.inputs), size=DRAWN)])
        with torch.no_grad():
            expected = self.start.acceleration(q, v, u)
        return square_norm(lagrangian.acceleration(q, v, u) - expected, metric).mean() / metric.shape[0]


def anchor_law(lagrangian: Lagrangian, trajectory: EncodedTrajectory) -> Anchor:
    """Make an anchor of ``lagrangian`` as it is now."""
    q = torch.from_numpy(trajectory.latents)
    at = list_starts(trajectory, before=0, after=1)
    velocity = trajectory.clock.slope(trajectory.latents, at, (1,))
    return Anchor(
        start=copy.deepcopy(lagrangian).requires_grad_(False),
        inputs=trajectory.inputs,
        middle=q.mean(0),
        spread=q.std(0),
        speed=torch.from_numpy(velocity).square().mean(0).sqrt() * float(lagrangian.time_unit_s),
    )


def anchored_error(error: Tensor, penalty: Tensor, *, weight: float) -> Scalar:
    """Compute ``error + weight * penalty * error``, where the last factor has no gradient.

    The gradient is proportional to that of ``log(error) + weight * penalty``, the log likelihood for errors
    of unknown size: the smaller the error, the more the frames count. A penalty of fixed size would vanish
    beside the errors of noisy latents and dominate those of clean ones.
    """
    return error + weight * error.detach() * penalty
