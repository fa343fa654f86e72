"""A learned law under a load, with its damping, inertia and stiffness edited.

The motion under forces that change with time.
"""

from dataclasses import dataclass
from math import isfinite

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Inputs, Latents, Spd
from lagsplat.stage2.lagrangian import Lagrangian, PreparedCoefficients
from lagsplat.stage2.rollout import advance


@dataclass(frozen=True)
class LawEdits:
    """Factors on ``C``, ``M`` and ``V``; 1 leaves a term as it was learned.

    Raises:
        ValueError: a factor that is not positive and finite; damping may be zero.

    Source: paper, "Interactive loop".
    """

    damping: float = 1.0
    inertia: float = 1.0
    stiffness: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (isfinite(value) and (value > 0.0 or (name == "damping" and value == 0.0))):
                raise ValueError(
                    f"edit {name}={value}: must be a positive number (damping may be 0); the law would not "
                    "come to rest, or not move at all"
                )


UNTOUCHED = LawEdits()


class LoadedLagrangian(Lagrangian):
    """The law ``base``, its parameters shared, with a generalised force on its right-hand side.

    ``load`` (d,), or (B, d) for a load a sample, in the law's own units of energy per whitened unit. A load
    that is held is conservative and has the potential ``-load.(q - q_r)``; that of the elastic energy, and
    not of the inputs, takes the edit of the stiffness.

    Raises:
        ValueError: a load that is not finite.

    Source: paper eq. (forced-eom) and Appendix, "Maintained force".
    """

    def __init__(self, base: Lagrangian, load: Float[Tensor, "*B d"], *, edits: LawEdits = UNTOUCHED) -> None:
        torch.nn.Module.__init__(self)
        self.__dict__.update(base.__dict__)
        if not bool(torch.isfinite(load).all()):
            raise ValueError(
                "a force is not finite: give it as finite numbers, in pixels and energy per pixel"
            )
        self.load, self.edits = load, edits

    def mass(self, q: Latents) -> Spd:
        """``M(q)``, edited."""
        return self.edits.inertia * super().mass(q)

    def damping(self, q: Latents) -> Spd:
        """``C(q)`` per internal time unit, edited."""
        return self.edits.damping * super().damping(q)

    def potential(self, q: Latents) -> Float[Tensor, " B"]:
        """``V(q)``, edited, less the work of the load since the rest state."""
        return self.edits.stiffness * super().potential(q) - ((q - self.rest) * self.load).sum(1)

    def conservative_force(self, q: Latents, u: Inputs, ready: PreparedCoefficients) -> Latents:
        """Elastic force, edited, plus that of the inputs and the load."""
        force = super().conservative_force(q, u, ready)
        if self.edits.stiffness != 1.0:
            elastic = super().conservative_force(q, torch.zeros_like(u), ready)
            force = force + (self.edits.stiffness - 1.0) * elastic
        return force + self.load

    def acceleration(
        self, q: Latents, v: Latents, u: Inputs, *, ready: PreparedCoefficients | None = None
    ) -> Latents:
        """As the law's own, with load and edits; the velocity forces scale with the inertia and cancel."""
        ready = ready or self.prepare()
        force = self.conservative_force(q, u, ready)
        force = force - self.edits.damping * self.damping_term.product(q, v)
        return self.mass_term.accelerate(q, v, force / self.edits.inertia)


@torch.no_grad()
def rollout_under_force(
    law: Lagrangian,
    q0: Latents,
    v0: Latents,
    inputs: Float[Tensor, "B N n_u"],
    loads: Float[Tensor, "B N d"],
    *,
    dt_s: float,
    edits: LawEdits = UNTOUCHED,
) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
    """States and velocities (per second) at ``N`` instants ``dt_s`` apart; the first is the given one.

    Load ``i``, from `lagsplat.forces.grasp.GraspPoint.pull_back`, and input ``i`` are held from state ``i`` to
    ``i + 1``. Never raises on divergence: a row that leaves the finite numbers stays outside them.

    Raises:
        ValueError: a load that is not finite.

    Source: paper, "Interactive loop".
    """
    unit = float(law.time_unit_s)
    loaded = LoadedLagrangian(law, loads, edits=edits)
    ready = loaded.prepare()
    q, v = q0.double(), v0.double() * unit
    positions, velocities = [q], [v]
    for i in range(inputs.shape[1] - 1):
        loaded.load = loads[:, i]
        q, v = advance(loaded, q, v, inputs[:, i].double(), step=dt_s / unit, ready=ready)
        positions.append(q)
        velocities.append(v)
    return torch.stack(positions, 1), torch.stack(velocities, 1) / unit
