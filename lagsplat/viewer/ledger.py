"""The books of energy: what came in by the hand, the inputs and edits, what damping took, and what is left
over."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.forces.stepper import Stepper

Vector = Float64[np.ndarray, " d"]


@dataclass(frozen=True)
class Energy:
    """Energy now, and the flows since the books were opened, in the law's own unit.

    ``hand``, ``inputs`` and ``edits`` flowed in, ``dissipated`` out. ``error`` is what the integrator made or
    lost: ``total - began - hand - inputs - edits + dissipated``.
    """

    kinetic: float
    potential: float
    hand: float
    inputs: float
    edits: float
    dissipated: float
    began: float

    @property
    def total(self) -> float:
        """Kinetic plus potential."""
        return self.kinetic + self.potential

    @property
    def error(self) -> float:
        """What the books cannot explain."""
        return self.total - self.began - self.hand - self.inputs - self.edits + self.dissipated


class Ledger:
    """Books of one motion, kept step by step; `open` begins them anew.

    Within a step the hand's force is held, so that its work is exact; dissipation and the work of the inputs
    follow the trapezoidal rule, of the integrator's own order.

    Source: paper, Appendix, the energy balance.
    """

    def __init__(self, law: Stepper, q: Vector, v: Vector) -> None:
        self.open(law, q, v)

    def open(self, law: Stepper, q: Vector, v: Vector) -> None:
        """Begin at this state."""
        self.hand = self.inputs = self.edits = self.dissipated = 0.0
        self._look(law, q, v)
        self.began = self.kinetic + self.potential

    def edit(self, law: Stepper, q: Vector, v: Vector) -> None:
        """The law was changed in this state: what its energy jumps by was put in from outside."""
        before = self.kinetic + self.potential
        self._look(law, q, v)
        self.edits += self.kinetic + self.potential - before

    def book(
        self,
        law: Stepper,
        before: tuple[Vector, Vector],
        after: tuple[Vector, Vector],
        u: Float64[np.ndarray, " n_u"],
        load: Vector,
        *,
        dt_s: float,
    ) -> None:
        """One step from ``before`` to ``after`` under the held inputs and generalised force."""
        way = after[0] - before[0]
        self.hand += float(load @ way)
        if len(u):
            none = np.zeros_like(u)
            push = [
                law.conservative_force(q, u) - law.conservative_force(q, none) for q, _ in (before, after)
            ]
            self.inputs += float(0.5 * (push[0] + push[1]) @ way)
        taken = [law.dissipated_power(q, v) for q, v in (before, after)]
        self.dissipated += 0.5 * dt_s * (taken[0] + taken[1])
        self._look(law, *after)

    def told(self) -> Energy:
        """The books as they stand."""
        return Energy(
            self.kinetic, self.potential, self.hand, self.inputs, self.edits, self.dissipated, self.began
        )

    def _look(self, law: Stepper, q: Vector, v: Vector) -> None:
        self.kinetic, self.potential = law.kinetic(q, v), law.potential(q)
