"""Errors of forecasts in the visibility metric, and the one-step objective."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latents, Metric, Scalar
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.rollout import ShootingWindows, verlet_step


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
