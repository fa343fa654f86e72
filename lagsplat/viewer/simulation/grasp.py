"""The grasp of a user: the force of a drag on the grasped matter, and the energy balance."""

from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.forces.equilibrium import OperatingPoint, compute_static_stiffness
from lagsplat.forces.grasp import GraspPoint, NoMatterError, Place, Point, grasp_along_ray, grasp_brush
from lagsplat.forces.loaded_lagrangian import FastLagrangian
from lagsplat.forces.moving_parts import STILL

Vector = Float64[np.ndarray, " d"]


@dataclass(frozen=True)
class EnergyTerms:
    """Energy now, and the energy that flowed since the last reset, in the law's own unit.

    ``hand_work``, ``input_work`` and ``edit_work`` flowed in, ``dissipated`` flowed out, ``initial`` is the
    energy at the reset.
    """

    kinetic: float
    potential: float
    hand_work: float
    input_work: float
    edit_work: float
    dissipated: float
    initial: float

    @property
    def total(self) -> float:
        """Kinetic plus potential energy."""
        return self.kinetic + self.potential

    @property
    def error(self) -> float:
        """The energy that the integrator created or lost."""
        return self.total - self.initial - self.hand_work - self.input_work - self.edit_work + self.dissipated


class EnergyBalance:
    """The energy balance of a motion, updated step by step.

    The force of the hand is constant within a step, so its work is exact. Dissipation and the work of the
    inputs use the trapezoidal rule, which has the order of the integrator.

    Source: paper, Appendix, the energy balance.
    """

    def __init__(self, law: FastLagrangian, q: Vector, v: Vector) -> None:
        self.reset(law, q, v)

    def reset(self, law: FastLagrangian, q: Vector, v: Vector) -> None:
        """Start a new balance at the state ``q`` with the velocity ``v`` [1/s]."""
        self.hand_work = self.input_work = self.edit_work = self.dissipated = 0.0
        self._evaluate(law, q, v)
        self.initial = self.kinetic + self.potential

    def record_edit(self, law: FastLagrangian, q: Vector, v: Vector) -> None:
        """Count the jump of the energy when the law is edited as work from outside."""
        before = self.kinetic + self.potential
        self._evaluate(law, q, v)
        self.edit_work += self.kinetic + self.potential - before

    def record_step(
        self,
        law: FastLagrangian,
        before: tuple[Vector, Vector],
        after: tuple[Vector, Vector],
        u: Float64[np.ndarray, " n_u"],
        load: Vector,
        *,
        dt_s: float,
    ) -> None:
        """Add one step to the balance."""
        displacement = after[0] - before[0]
        self.hand_work += float(load @ displacement)
        if len(u):
            zero = np.zeros_like(u)
            start, end = (
                law.conservative_force(q, u) - law.conservative_force(q, zero) for q, _ in (before, after)
            )
            self.input_work += float(0.5 * (start + end) @ displacement)
        power = [float(law.dissipated_power(q, v)) for q, v in (before, after)]
        self.dissipated += 0.5 * dt_s * (power[0] + power[1])
        self._evaluate(law, *after)

    def terms(self) -> EnergyTerms:
        """The balance as it is now."""
        return EnergyTerms(**{field.name: getattr(self, field.name) for field in fields(EnergyTerms)})

    def _evaluate(self, law: FastLagrangian, q: Vector, v: Vector) -> None:
        self.kinetic, self.potential = float(law.kinetic(q, v)), float(law.potential(q))


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
    def load(self) -> Float64[np.ndarray, " d"]:
        """The generalised force [energy of the law per whitened unit]."""
        return self.force @ self.grasp_point.jacobian.numpy()

    def place(self, q: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, " n"]:
        """Position of the grasped matter at the state ``q`` [px]."""
        return self.grasp_point.place(torch.from_numpy(q)).numpy()


class GraspModel:
    """Turns a drag into a force: the radius of the brush and the force per pixel of drag.

    The ``gain`` [energy per px^2] is chosen from the stiffness at rest: a drag of ``drag_px`` on the object
    moves the state by the share ``response`` of the visited radius.

    Args:
        operating_point: the run at rest.
        radius_px: radius of the brush [px].
        drag_px: the drag that produces ``response`` [px].
        response: share of the visited radius.
    """

    def __init__(
        self, operating_point: OperatingPoint, *, radius_px: float, drag_px: float, response: float
    ) -> None:
        self.kinematics, self.radius_px = operating_point.kinematics, radius_px
        present = operating_point.kinematics.presence(operating_point.rest[None])[0] > PRESENT
        jacobian = operating_point.kinematics.geometry.jacobian
        motion = jacobian.flatten(1).norm(dim=1)
        visible = motion[present] if bool(present.any()) else motion
        self.largest_motion = float(visible.quantile(LARGEST))
        # at least one must remain, even where all motions are equal or the decoder has few Gaussians
        chosen = jacobian[present & (motion >= OBJECT * self.largest_motion)]
        chosen = chosen if len(chosen) else jacobian[motion.argmax()][None]
        values, vectors = torch.linalg.eigh(
            compute_static_stiffness(
                operating_point.law, operating_point.rest[None], operating_point.u[None]
            )[0]
        )
        values = values.abs().clamp(min=WEAKEST * float(values.abs().max()))
        compliance = (vectors / values) @ vectors.T
        answers = torch.linalg.matrix_norm(chosen @ compliance, ord=2)
        self.gain = response * operating_point.visited_radius / (float(answers.median()) * drag_px)

    def grasp(self, q: Float64[np.ndarray, " d"], at: Point | Place, *, gaussian: int | None = None) -> Grasp:
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
            grasp_point = replace(
                grasp_along_ray(self.kinematics, state, gaussian), at=torch.tensor(at, dtype=torch.float64)
            )
        is_background = float(grasp_point.jacobian.norm()) < STILL * self.largest_motion
        return Grasp(grasp_point, np.zeros(self.kinematics.space), is_background)
