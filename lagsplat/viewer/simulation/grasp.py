"""The books of energy: what came in by the hand, the inputs and edits, what damping took, and what is left
over.

The hand: a drag in the picture as a force on the matter that was grasped.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.forces.equilibrium import OperatingPoint, static_stiffness
from lagsplat.forces.grasp import GraspPoint, NoMatterError, Place, Point, grasp_along_ray, grasp_brush
from lagsplat.forces.loaded_lagrangian import FastLagrangian
from lagsplat.forces.moving_parts import STILL

Vector = Float64[np.ndarray, " d"]


@dataclass(frozen=True)
class EnergyTerms:
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


class EnergyBalance:
    """Books of one motion, kept step by step; `open` begins them anew.

    Within a step the hand's force is held, so that its work is exact; dissipation and the work of the inputs
    follow the trapezoidal rule, of the integrator's own order.

    Source: paper, Appendix, the energy balance.
    """

    def __init__(self, law: FastLagrangian, q: Vector, v: Vector) -> None:
        self.open(law, q, v)

    def open(self, law: FastLagrangian, q: Vector, v: Vector) -> None:
        """Begin at this state."""
        self.hand = self.inputs = self.edits = self.dissipated = 0.0
        self._look(law, q, v)
        self.began = self.kinetic + self.potential

    def edit(self, law: FastLagrangian, q: Vector, v: Vector) -> None:
        """The law was changed in this state: what its energy jumps by was put in from outside."""
        before = self.kinetic + self.potential
        self._look(law, q, v)
        self.edits += self.kinetic + self.potential - before

    def book(
        self,
        law: FastLagrangian,
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

    def told(self) -> EnergyTerms:
        """The books as they stand."""
        return EnergyTerms(
            self.kinetic, self.potential, self.hand, self.inputs, self.edits, self.dissipated, self.began
        )

    def _look(self, law: FastLagrangian, q: Vector, v: Vector) -> None:
        self.kinetic, self.potential = law.kinetic(q, v), law.potential(q)


OBJECT = 0.5
"""Of the largest motion: Gaussians that move as much decide how strong a drag is."""
PRESENT = 0.1
LARGEST = 0.98
"""The quantile of the motions that counts as the largest."""
WEAKEST = 1e-6
"""Of the largest stiffness: what is softer, or unstable, is taken to be as stiff as this."""


@dataclass(frozen=True)
class Grasp:
    """What holds the matter of ``grip`` with ``force`` [energy of the law per px]: right, down and, in
    space, ahead of the film's camera.

    ``still`` says that the matter grasped there hardly moves with any coordinate: it is background.
    """

    grip: GraspPoint
    force: Float64[np.ndarray, " n"]
    still: bool

    @property
    def load(self) -> Float64[np.ndarray, " d"]:
        """The generalised force."""
        return self.force @ self.grip.jacobian.numpy()

    def place(self, q: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, " n"]:
        """Where the matter is now [px]."""
        return self.grip.place(torch.from_numpy(q)).numpy()


class GraspModel:
    """How a picture is touched: the width of the brush, and how much force a pixel of drag is worth.

    ``gain`` [energy per px^2] is such that a drag of ``drag_px`` on the object drives the state
    ``response`` of the visited range away from rest, by the stiffness there.
    """

    def __init__(self, held: OperatingPoint, *, radius_px: float, drag_px: float, response: float) -> None:
        self.kinematics, self.radius_px = held.kinematics, radius_px
        present = held.kinematics.presence(held.rest[None])[0] > PRESENT
        jacobian = held.kinematics.geometry.jacobian
        motion = jacobian.flatten(1).norm(dim=1)
        shown = motion[present] if bool(present.any()) else motion
        self.motion = float(shown.quantile(LARGEST))
        # ties and a decoder of few Gaussians must leave at least one of them
        chosen = jacobian[present & (motion >= OBJECT * self.motion)]
        chosen = chosen if len(chosen) else jacobian[motion.argmax()][None]
        values, vectors = torch.linalg.eigh(static_stiffness(held.law, held.rest[None], held.u[None])[0])
        values = values.abs().clamp(min=WEAKEST * float(values.abs().max()))
        compliance = (vectors / values) @ vectors.T
        answers = torch.linalg.matrix_norm(chosen @ compliance, ord=2)
        self.gain = response * held.reach / (float(answers.median()) * drag_px)

    def grasp(self, q: Float64[np.ndarray, " d"], at: Point | Place, *, met: int | None = None) -> Grasp:
        """Take hold of the matter around ``at`` [px] at the state ``q``, without pulling yet.

        Of the Gaussian ``met`` alone where no centre is under the brush, and one was met.

        Raises:
            ValueError: as `lagsplat.forces.grasp.grasp_brush`.
        """
        state = torch.from_numpy(q)
        try:
            grip = grasp_brush(self.kinematics, state, at, radius=self.radius_px)
        except NoMatterError:
            if met is None:
                raise
            grip = replace(
                grasp_along_ray(self.kinematics, state, met), at=torch.tensor(at, dtype=torch.float64)
            )
        still = float(grip.jacobian.norm()) < STILL * self.motion
        return Grasp(grip, np.zeros(self.kinematics.space), still)
