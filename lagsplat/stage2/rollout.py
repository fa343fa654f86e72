"""Forecasts of the learned dynamics."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.shapes import Latents
from lagsplat.stage2.integrate import Steps, advance, step_of
from lagsplat.stage2.lagrangian import Lagrangian


@torch.no_grad()
def rollout(
    lagrangian: Lagrangian,
    q0: Latents,
    v0: Latents,
    inputs: Float[Tensor, "B N n_u"],
    *,
    dt_s: Steps,
) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
    """States and velocities (per second) at ``N`` instants ``dt_s`` apart; the first is the given one.

    ``dt_s`` is one number, or where frames are not evenly spaced ``N - 1`` of them, the same for all rows or
    each row its own. Input ``i`` is held from state ``i`` to ``i + 1``; the last
    one is unused. Never raises on divergence: a row that leaves the finite numbers is NaN from there on.
    """
    unit = float(lagrangian.time_unit_s)
    ready = lagrangian.prepare()
    q, v, steps = q0.double(), v0.double() * unit, dt_s / unit
    inputs = inputs.double()
    positions, velocities = [q], [v]
    for i in range(inputs.shape[1] - 1):
        q, v = advance(lagrangian, q, v, inputs[:, i], step=step_of(steps, i), ready=ready)
        finite = torch.isfinite(q).all(1, keepdim=True) & torch.isfinite(v).all(1, keepdim=True)
        q, v = q.where(finite, torch.nan), v.where(finite, torch.nan)
        positions.append(q)
        velocities.append(v)
    return torch.stack(positions, 1), torch.stack(velocities, 1) / unit
