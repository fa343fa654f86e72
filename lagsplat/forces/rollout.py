"""The motion under forces that change with time."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.forces.loaded import UNTOUCHED, Edits, Loaded
from lagsplat.shapes import Latents
from lagsplat.stage2.integrate import advance
from lagsplat.stage2.lagrangian import Lagrangian


@torch.no_grad()
def push_along(
    law: Lagrangian,
    q0: Latents,
    v0: Latents,
    inputs: Float[Tensor, "B N n_u"],
    loads: Float[Tensor, "B N d"],
    *,
    dt_s: float,
    edits: Edits = UNTOUCHED,
) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
    """States and velocities (per second) at ``N`` instants ``dt_s`` apart; the first is the given one.

    Load ``i``, from `lagsplat.forces.grip.Grip.pull_back`, and input ``i`` are held from state ``i`` to
    ``i + 1``. Never raises on divergence: a row that leaves the finite numbers stays outside them.

    Raises:
        ValueError: a load that is not finite.

    Source: paper, "Interactive loop".
    """
    unit = float(law.time_unit_s)
    loaded = Loaded(law, loads, edits=edits)
    ready = loaded.prepare()
    q, v = q0.double(), v0.double() * unit
    positions, velocities = [q], [v]
    for i in range(inputs.shape[1] - 1):
        loaded.load = loads[:, i]
        q, v = advance(loaded, q, v, inputs[:, i].double(), step=dt_s / unit, ready=ready)
        positions.append(q)
        velocities.append(v)
    return torch.stack(positions, 1), torch.stack(velocities, 1) / unit
