"""What stage 2 minimises: errors of forecasts, in the ridged visibility metric.

A price on leaving the constant law where the clip has nothing to say.
"""

import copy
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

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


def add_ridge(metric: Float[Tensor, "d d"], *, ridge: float) -> Float[Tensor, "d d"]:
    """``G + ridge lambda_max(G) I``, scaled to trace ``d``.

    Caps the ratio of weights between two directions at about ``1 / ridge``, so that a direction nothing can
    see stays constrained.

    Source: paper eq. (physics_loss) and the text below it.
    """
    d = metric.shape[0]
    largest = torch.linalg.eigvalsh(metric)[-1]
    whole = metric + ridge * largest * torch.eye(d, dtype=metric.dtype)
    return whole * (d / torch.trace(whole))


def square_norm(error: Float[Tensor, "*B d"], metric: Float[Tensor, "d d"]) -> Float[Tensor, "*B"]:
    """``error . metric error``."""
    return ((error @ metric) * error).sum(-1)


def one_step_error(
    lagrangian: Lagrangian, windows: ShootingWindows, metric: Float[Tensor, "d d"], *, velocity_weight: float
) -> Float[Tensor, ""]:
    """Mean error of one velocity-Verlet step, position plus velocity times the step.

    Source: paper eq. (physics_loss).
    """
    q, v = verlet_step(
        lagrangian, windows.q, windows.v, windows.u, step=windows.step, ready=lagrangian.prepare()
    )
    position = square_norm(q - windows.q_next, metric)
    velocity = square_norm(windows.step * (v - windows.v_next), metric)
    return (position + velocity_weight * velocity).mean() / metric.shape[0]


def shooting_error(
    lagrangian: Lagrangian, shots: ShootingTargets, metric: Float[Tensor, "d d"]
) -> Float[Tensor, ""]:
    """Mean position error of a rollout over every state after the first."""
    ready = lagrangian.prepare()
    q, v = shots.q, shots.v
    path = []
    for i in range(shots.targets.shape[1] - 1):
        step = choose_step(shots.steps, i)
        q, v = advance(lagrangian, q, v, shots.inputs[:, i], step=step, ready=ready)
        path.append(q)
    return square_norm(torch.stack(path, 1) - shots.targets[:, 1:], metric).mean() / metric.shape[0]


REACH = 2.5
"""Spread of the positions asked about, over that of the clip: few lie among its frames, most outside."""
DRAWN = 256
"""States a price."""


@dataclass(frozen=True)
class Anchor:
    """The law a descent began with, and the states on which later laws are compared with it.

    Networks are free wherever no frame contradicts them, above all just outside the clip, where a released
    mechanism comes to rest. There the law a descent began with, which has few coefficients and hence knows
    them from all frames, is the better guess. Among the frames their evidence has to outweigh it: see
    `anchored_error`.
    """

    start: Lagrangian
    inputs: Float[np.ndarray, "T n_u"]
    middle: Float[Tensor, " d"]
    spread: Float[Tensor, " d"]
    speed: Float[Tensor, " d"]  # rms, per internal time unit

    def penalty(
        self, lagrangian: Lagrangian, metric: Float[Tensor, "d d"], rng: np.random.Generator
    ) -> Float[Tensor, ""]:
        """Mean square difference of the accelerations of the two laws, over normal positions and velocities
        and over inputs of the clip, each drawn by itself.
        """
        draw = torch.from_numpy(rng.standard_normal((2, DRAWN, len(self.middle))))
        q = self.middle + REACH * self.spread * draw[0]
        v = self.speed * draw[1]
        u = torch.from_numpy(self.inputs[rng.integers(len(self.inputs), size=DRAWN)])
        with torch.no_grad():
            known = self.start.acceleration(q, v, u)
        return square_norm(lagrangian.acceleration(q, v, u) - known, metric).mean() / metric.shape[0]


def anchor_law(lagrangian: Lagrangian, trajectory: EncodedTrajectory) -> Anchor:
    """Hold on to ``lagrangian`` as it now is."""
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


def anchored_error(
    error: Float[Tensor, ""], penalty: Float[Tensor, ""], *, weight: float
) -> Float[Tensor, ""]:
    """``error``, and for each unit of ``penalty`` a further ``weight`` times what the error now is.

    Its slope is that of ``log(error) + weight * price``, the likelihood of errors whose size only the fit
    tells: the better frames can be followed, the more they count. A price of fixed size is lost in the errors
    of noisy latents and is all that a law of clean ones is fitted to.
    """
    return error + weight * error.detach() * penalty
