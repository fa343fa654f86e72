"""What stage 2 minimises: errors of forecasts, in the ridged visibility metric."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.stage2.integrate import advance, step_of, verlet_step
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.windows import Shots, Windows


def ridged(metric: Float[Tensor, "d d"], *, ridge: float) -> Float[Tensor, "d d"]:
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
    lagrangian: Lagrangian, windows: Windows, metric: Float[Tensor, "d d"], *, velocity_weight: float
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


def shooting_error(lagrangian: Lagrangian, shots: Shots, metric: Float[Tensor, "d d"]) -> Float[Tensor, ""]:
    """Mean position error of a rollout over every state after the first."""
    ready = lagrangian.prepare()
    q, v = shots.q, shots.v
    path = []
    for i in range(shots.targets.shape[1] - 1):
        step = step_of(shots.steps, i)
        q, v = advance(lagrangian, q, v, shots.inputs[:, i], step=step, ready=ready)
        path.append(q)
    return square_norm(torch.stack(path, 1) - shots.targets[:, 1:], metric).mean() / metric.shape[0]
