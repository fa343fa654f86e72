"""Whichever form of a law steps one state at a time: plain arrays, or tensors where the decoder gives the
mass."""

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.forces.loaded import UNTOUCHED, Edits, Loaded
from lagsplat.forces.single import Single
from lagsplat.stage2.induced import InducedMass
from lagsplat.stage2.integrate import advance
from lagsplat.stage2.lagrangian import Lagrangian

Vector = Float64[np.ndarray, " d"]
Held = Float64[np.ndarray, " n_u"]


class Batched:
    """The tensors of a law for one state, as `Single`: for masses that are sums over the decoder's
    Gaussians."""

    def __init__(self, law: Lagrangian, *, edits: Edits = UNTOUCHED) -> None:
        self.edits, self.unit_s = edits, float(law.time_unit_s)
        self.law = Loaded(law, torch.zeros(law.d, dtype=torch.float64), edits=edits)
        with torch.no_grad():
            self.ready = law.prepare()

    @torch.no_grad()
    def step(self, q: Vector, v: Vector, u: Held, load: Vector, *, dt_s: float) -> tuple[Vector, Vector]:
        """State and velocity [1/s] ``dt_s`` later, input and generalised force held."""
        self.law.load = torch.from_numpy(load)
        state, velocity = advance(
            self.law, _row(q), _row(v * self.unit_s), _row(u), step=dt_s / self.unit_s, ready=self.ready
        )
        return state[0].numpy(), velocity[0].numpy() / self.unit_s

    @torch.no_grad()
    def conservative_force(self, q: Vector, u: Held) -> Vector:
        """``-grad (V - u.nu)``."""
        self.law.load = torch.zeros_like(self.law.load)
        return self.law.conservative_force(_row(q), _row(u), self.ready)[0].numpy()

    @torch.no_grad()
    def potential(self, q: Vector) -> float:
        """``V(q)``."""
        self.law.load = torch.zeros_like(self.law.load)
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


Stepper = Single | Batched
"""A law with its edits, one state at a time."""


def stepper(law: Lagrangian, *, edits: Edits = UNTOUCHED) -> Stepper:
    """The fastest of the two forms that can carry ``law``."""
    return Batched(law, edits=edits) if isinstance(law.mass_term, InducedMass) else Single(law, edits=edits)


def _row(x: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(x)[None]
