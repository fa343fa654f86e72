"""The grasp of a user: the force of a drag on the grasped matter, and the energy balance."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.array_types import Vector
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.equilibrium import OperatingPoint, compute_static_stiffness
from lagsplat.forces.grasp import GraspPoint, NoMatterError, Place, Point, grasp_along_ray, grasp_brush
from lagsplat.forces.loaded_lagrangian import FastLagrangian
from lagsplat.forces.moving_parts import STILL

State = tuple[Vector, Vector]  # q and its velocity [1/s]


@dataclass(frozen=True)
class EnergyBalance:
    """Energy now, and the energy that flowed since the last reset, in the law's own unit.

    ``hand_work``, ``input_work`` and ``edit_work`` flowed in, ``dissipated`` flowed out, ``initial`` is the
    energy at the reset. The force of the hand is constant within a step, so its work is exact. Dissipation
    and the work of the inputs use the trapezoidal rule, which has the order of the integrator.

    Source: paper, Appendix, the energy balance.
    """

    kinetic: float
    potential: float
    initial: float
    hand_work: float = 0.0
    input_work: float = 0.0
    edit_work: float = 0.0
    dissipated: float = 0.0

    @classmethod
    def begin(cls, law: FastLagrangian, q: Vector, v: Vector) -> "EnergyBalance":
        """A new balance at the state ``q`` with the velocity ``v`` [1/s]."""
        kinetic, potential = float(law.kinetic(q, v)), float(law.potential(q))
        return cls(kinetic, potential, initial=kinetic + potential)

    @property
    def total(self) -> float:
        """Kinetic plus potential energy."""
        return self.kinetic + self.potential

    @property
    def error(self) -> float:
        """The energy that the integrator created or lost."""
        return self.total - self.initial - self.hand_work - self.input_work - self.edit_work + self.dissipated

    def after_edit(self, law: FastLagrangian, q: Vector, v: Vector) -> "EnergyBalance":
        """The balance under an edited law: the jump of the energy is work from outside."""
        after = self._at(law, q, v)
        return replace(after, edit_work=self.edit_work + (after.kinetic + after.potential - self.total))

    def after_step(
        self, law: FastLagrangian, before: State, after: State, u: np.ndarray, load: Vector, *, dt_s: float
    ) -> "EnergyBalance":
        """The balance one step later, under the inputs ``u`` (n_u,) and a generalised force."""
        displacement = after[0] - before[0]
        input_work = self.input_work
        if len(u):
            force, zero = law.conservative_force, np.zeros_like(u)
            start, end = (force(q, u) - force(q, zero) for q, _ in (before, after))
            input_work += float(0.5 * (start + end) @ displacement)
        hand_work = self.hand_work + float(load @ displacement)
        power = [float(law.dissipated_power(q, v)) for q, v in (before, after)]
        dissipated = self.dissipated + 0.5 * dt_s * (power[0] + power[1])
        now = self._at(law, *after)
        return replace(now, hand_work=hand_work, input_work=input_work, dissipated=dissipated)

    def _at(self, law: FastLagrangian, q: Vector, v: Vector) -> "EnergyBalance":
        return replace(self, kinetic=float(law.kinetic(q, v)), potential=float(law.potential(q)))


OBJECT = 0.5
"""Share of the largest motion: the Gaussians that move at least as much set the strength of a drag."""
PRESENT = 0.1  # opacity above which a Gaussian counts as visible at rest
LARGEST = 0.98  # quantile of the motions that is taken as the largest, so that a few outliers do not set it
WEAKEST = 1e-6
"""Share of the largest stiffness: lower bound on every stiffness, and the size of an unstable one."""


@dataclass(frozen=True)
class Grasp:
    """A force on the matter of ``grasp_point``.

    ``force`` [energy of the law per px] points right, down and, in space, away from the recording camera.
    ``is_background`` is true where the matter hardly moves with any coordinate.
    """

    grasp_point: GraspPoint
    force: Float64[np.ndarray, " n"]
    is_background: bool

    @property
    def load(self) -> Vector:
        """The generalised force [energy of the law per whitened unit]."""
        return self.force @ self.grasp_point.jacobian.numpy()

    def place(self, q: Vector) -> Float64[np.ndarray, " n"]:
        """Position of the grasped matter at the state ``q`` [px]."""
        return self.grasp_point.place(torch.from_numpy(q)).numpy()


class GraspModel:
    """Turns a drag into a force: the radius of the brush and the force per pixel of drag.

    The ``gain`` [energy per px^2] is chosen from the stiffness at rest: a drag of ``reach`` image widths on
    the object moves the state by the share `ForcesConfig.response` of the visited radius.
    """

    def __init__(self, operating_point: OperatingPoint, forces: ForcesConfig, *, reach: float) -> None:
        kinematics, rest = operating_point.kinematics, operating_point.rest[None]
        self.kinematics, self.radius_px = kinematics, forces.brush * kinematics.width
        present = kinematics.presence(rest)[0] > PRESENT
        jacobian = kinematics.geometry.jacobian
        motion = jacobian.flatten(1).norm(dim=1)
        visible = motion[present] if bool(present.any()) else motion
        self.largest_motion = float(visible.quantile(LARGEST))
        # at least one must remain, even where all motions are equal or the decoder has few Gaussians
        chosen = jacobian[present & (motion >= OBJECT * self.largest_motion)]
        chosen = chosen if len(chosen) else jacobian[motion.argmax()][None]
        stiffness = compute_static_stiffness(operating_point.law, rest, operating_point.u[None])[0]
        values, vectors = torch.linalg.eigh(stiffness)
        values = values.abs().clamp(min=WEAKEST * float(values.abs().max()))
        compliance = (vectors / values) @ vectors.T
        answers = torch.linalg.matrix_norm(chosen @ compliance, ord=2)
        drag_px = reach * kinematics.width
        self.gain = forces.response * operating_point.visited_radius / (float(answers.median()) * drag_px)

    def grasp(self, q: Vector, at: Point | Place, *, gaussian: int | None = None) -> Grasp:
        """Grasp the matter around ``at`` [px] at the state ``q``, without pulling yet.

        Where no centre is under the brush, the Gaussian with the number ``gaussian`` is grasped, if one is
        given.
        """
        state = torch.from_numpy(q)
        try:
            grasp_point = grasp_brush(self.kinematics, state, at, radius=self.radius_px)
        except NoMatterError:
            if gaussian is None:
                raise
            grasp_point = grasp_along_ray(self.kinematics, state, gaussian)
            grasp_point = replace(grasp_point, at=torch.tensor(at, dtype=torch.float64))
        is_background = float(grasp_point.jacobian.norm()) < STILL * self.largest_motion
        return Grasp(grasp_point, np.zeros(self.kinematics.space), is_background)
