"""A fitted law under a load, with edited damping, inertia and stiffness."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.array_types import Inputs, Latent, Latents, Spd, Vector
from lagsplat.forces.loads import ConstantLoad, Load, make_no_load
from lagsplat.stage2.decoder_mass import InducedMass
from lagsplat.stage2.equilibrium import find_equilibria
from lagsplat.stage2.lagrangian import UNTOUCHED, Lagrangian, LawEdits, PreparedCoefficients
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian
from lagsplat.stage2.rollout import advance

Input = Float64[np.ndarray, " n_u"]


class LoadedLagrangian(Lagrangian):
    """The law ``base`` with a load on its right-hand side; it shares the parameters.

    A load is conservative: its potential is minus its work. The edit of the stiffness scales the elastic
    energy, not the work of the inputs.

    Source: paper eq. (forced-eom) and Appendix, "Maintained force".
    """

    def __init__(self, base: Lagrangian, load: Load, *, edits: LawEdits = UNTOUCHED) -> None:
        torch.nn.Module.__init__(self)
        self.__dict__.update(base.__dict__)
        self.load, self.edits = load, edits

    def mass(self, q: Latents) -> Spd:
        """``M(q)``, edited."""
        return self.edits.inertia * super().mass(q)

    def damping(self, q: Latents) -> Spd:
        """``C(q)`` per internal time unit, edited."""
        return self.edits.damping * super().damping(q)

    def potential(self, q: Latents) -> Float[Tensor, " B"]:
        """``V(q)``, edited, less the work of the load from the rest state."""
        work = self.load.work(q) - self.load.work(self.rest.expand_as(q))
        return self.edits.stiffness * super().potential(q) - work

    def conservative_force(self, q: Latents, u: Inputs, ready: PreparedCoefficients) -> Latents:
        """Elastic force, edited, plus the forces of the inputs and the load."""
        force = super().conservative_force(q, u, ready)
        if self.edits.stiffness != 1.0:
            elastic = super().conservative_force(q, torch.zeros_like(u), ready)
            force = force + (self.edits.stiffness - 1.0) * elastic
        return force + self.load.generalise(q)

    def acceleration(
        self, q: Latents, v: Latents, u: Inputs, *, ready: PreparedCoefficients | None = None
    ) -> Latents:
        """Acceleration under load and edits; the factor of the inertia cancels in the velocity forces."""
        ready = ready or self.prepare()
        force = self.conservative_force(q, u, ready) - self.edits.damping * self.resist(q, v)
        return self.accelerate(q, v, force / self.edits.inertia)


def find_loaded_equilibria(
    law: Lagrangian,
    u: Inputs,
    load: Load | None = None,
    *,
    edits: LawEdits = UNTOUCHED,
    start: Latent | Latents | None = None,
) -> Latents:
    """Find the equilibria (B, d) of a law with edits under inputs ``u`` and a ``load``, one per row.

    The work of a load is at most linear far away, where the quadratic floor of ``V`` outgrows it. ``start``
    and errors are as of `lagsplat.stage2.equilibrium.find_equilibria`.
    """
    load = make_no_load(law.d) if load is None else load
    return find_equilibria(LoadedLagrangian(law, load, edits=edits), u, start)


@torch.no_grad()
def rollout_under_force(
    law: Lagrangian,
    q0: Latents,
    v0: Latents,
    inputs: Float[Tensor, "B N n_u"],
    loads: Sequence[Load],
    *,
    dt_s: float,
    edits: LawEdits = UNTOUCHED,
) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
    """Roll out states and velocities [1/s] at ``N`` instants ``dt_s`` apart; the first is the given one.

    Load ``i`` of ``N - 1`` and input ``i`` act from state ``i`` to ``i + 1``. Never raises on divergence: a
    row that leaves the finite numbers stays outside them.

    Source: paper, "Interactive loop".
    """
    unit = float(law.time_unit_s)
    loaded = LoadedLagrangian(law, make_no_load(law.d), edits=edits)
    ready = loaded.prepare()
    q, v = q0.double(), v0.double() * unit
    positions, velocities = [q], [v]
    for i in range(inputs.shape[1] - 1):
        loaded.load = loads[i]
        q, v = advance(loaded, q, v, inputs[:, i].double(), step=dt_s / unit, ready=ready)
        positions.append(q)
        velocities.append(v)
    return torch.stack(positions, 1), torch.stack(velocities, 1) / unit


class TorchLagrangian:
    """A law for one state at a time as `NumpyLagrangian`, in tensors, for masses induced by the decoder."""

    def __init__(self, law: Lagrangian, *, edits: LawEdits = UNTOUCHED) -> None:
        self.edits, self.unit_s = edits, float(law.time_unit_s)
        unloaded = make_no_load(law.d)
        self.law, self.loaded = (LoadedLagrangian(law, unloaded, edits=edits) for _ in range(2))
        with torch.no_grad():
            self.ready = law.prepare()

    @torch.no_grad()
    def step(self, q: Vector, v: Vector, u: Input, load: Vector, *, dt_s: float) -> tuple[Vector, Vector]:
        """State and velocity [1/s] ``dt_s`` later under constant input and generalised force."""
        self.loaded.load = ConstantLoad(_row(load))
        now = (_row(q), _row(v * self.unit_s), _row(u))
        state, velocity = advance(self.loaded, *now, step=dt_s / self.unit_s, ready=self.ready)
        return state[0].numpy(), velocity[0].numpy() / self.unit_s

    @torch.no_grad()
    def conservative_force(self, q: Vector, u: Input) -> Vector:
        """``-grad (V - u.nu)``."""
        return self.law.conservative_force(_row(q), _row(u), self.ready)[0].numpy()

    @torch.no_grad()
    def potential(self, q: Vector) -> float:
        """``V(q)``."""
        return float(self.law.potential(_row(q))[0])

    @torch.no_grad()
    def kinetic(self, q: Vector, v: Vector) -> float:
        """``v.M v / 2`` at a velocity in 1/s."""
        w = v * self.unit_s
        return float(0.5 * w @ self.law.mass(_row(q))[0].numpy() @ w)

    @torch.no_grad()
    def dissipated_power(self, q: Vector, v: Vector) -> float:
        """``v.C v`` per second, at a velocity in 1/s."""
        w = v * self.unit_s
        return float(w @ self.law.damping(_row(q))[0].numpy() @ w / self.unit_s)


def _row(x: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(x)[None]


FastLagrangian = NumpyLagrangian | TorchLagrangian  # fast for one state at a time


def make_fast_lagrangian(law: Lagrangian, *, edits: LawEdits = UNTOUCHED) -> FastLagrangian:
    """Convert a law with its edits to arrays, or to tensors where the decoder induces the mass."""
    induced = isinstance(law.mass_term, InducedMass)
    return TorchLagrangian(law, edits=edits) if induced else NumpyLagrangian(law, edits=edits)
