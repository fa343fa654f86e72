"""The grasp of a user: the force of a drag on the grasped matter, and the energy balance."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.array_types import Vector
from lagsplat.forces.answer_spread import is_undetermined, measure_stiffness_spread
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.grasp import SPACING_PX, GraspPoint, Place, Point, grasp_brush
from lagsplat.forces.loaded_lagrangian import FastLagrangian
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.matter.body_motion import list_deviated
from lagsplat.stage2.equilibrium import compute_static_stiffness

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


FOLLOW = 0.65  # share of the way of the hand that the held matter goes at rest, to first order
LEAST_FOLLOW = 0.25  # share of the usual mobility that is the least one, so that forces at a pivot are finite
MOST_REACH = 2.0  # visited radii that a drag moves the state at most, to first order
OBJECT = 0.5  # share of the largest motion: points that move at least as much have the usual mobility
MOST_LAWS = 64  # drawn laws of which the spread of an answer is told
WEAKEST = 1e-6
"""Share of the largest stiffness: lower bound on every stiffness, and the size of an unstable one."""


@dataclass(frozen=True)
class Grasp:
    """A force on the matter of ``grasp_point``.

    ``force`` [energy of the law per px] points right, down and, in space, away from the recording camera.
    ``gain`` [energy per px^2] is the force of a short drag per pixel. ``answer`` is the motion of the state
    under a unit of force, to first order, as a share of the longest that a drag may cause. ``mobility`` is
    that of the matter [px per unit of force]; the covariance of the way under a force is the sum of outer
    products of that of each ``spread``. Without one it is not known.
    """

    grasp_point: GraspPoint
    gain: float
    answer: Float64[np.ndarray, "d n"]
    mobility: Float64[np.ndarray, "n n"]
    spread: Float64[np.ndarray, "k n n"]
    force: Float64[np.ndarray, " n"]

    @property
    def is_background(self) -> bool:
        """Whether no matter was under the brush, so that nothing can be moved."""
        return self.grasp_point.is_background

    def pulled(self, drag_px: Float64[np.ndarray, " n"], *, strength: float) -> "Grasp":
        """The same grasp under the force of a drag, limited by `MOST_REACH`, times ``strength``."""
        force = self.gain * drag_px
        return replace(self, force=strength / max(1.0, float(np.linalg.norm(self.answer @ force))) * force)

    @property
    def covariance(self) -> Float64[np.ndarray, "n n"]:
        """Of the way on which the force takes the matter in the end, to first order [px^2]."""
        ways = self.spread @ self.force
        return ways.T @ ways

    @property
    def is_undetermined(self) -> bool:
        """Whether the recording does not determine where the force takes the matter."""
        return is_undetermined(self.covariance, float(np.linalg.norm(self.mobility @ self.force)))

    def load(self, q: Vector) -> Vector:
        """The generalised force at the state ``q`` [energy of the law per whitened unit]."""
        return self.grasp_point.pull_back(torch.from_numpy(self.force), torch.from_numpy(q)).numpy()

    def place(self, q: Vector) -> Float64[np.ndarray, " n"]:
        """Position of the grasped matter at the state ``q`` [px]."""
        return self.grasp_point.place(torch.from_numpy(q)).numpy()


class GraspModel:
    """Turns a drag into a force: the radius of the brush [px], and how the matter answers to a force.

    Matter with the Jacobian ``J`` has the mobility ``|J C J^T|_F`` [px^2 per energy], where ``C`` is the
    ``compliance`` of the state at rest: its way under a unit of force, where it has one direction to go. The
    usual mobility is the median of points that move much (`OBJECT`) at rest; ``usual_gain`` [energy per px^2]
    is the gain at it.

    A film does not tell the unit of energy. In the one in which the usual mobility is what it is, the
    covariance of the compliance is the sum over drawn laws of outer products of ``spread`` (k, d, d), and
    ``excess`` is how much longer matter goes, as a share, under each deviation of the motion of each body.
    """

    def __init__(
        self,
        operating_point: OperatingPoint,
        forces: ForcesConfig,
        draws: Float64[np.ndarray, "m p"] | None = None,
    ) -> None:
        self.operating_point, rest = operating_point, operating_point.rest
        self.radius_px = max(SPACING_PX, forces.brush * operating_point.width)
        self.farthest = MOST_REACH * operating_point.visited_radius
        stiffness = compute_static_stiffness(operating_point.law, rest[None], operating_point.u[None])[0]
        values, vectors = torch.linalg.eigh(stiffness)
        values = values.abs().clamp(min=WEAKEST * float(values.abs().max()))
        compliance = (vectors / values) @ vectors.T
        jacobian = operating_point.matter.jacobian(rest)
        motion = jacobian.flatten(1).norm(dim=1)
        rows = (motion >= OBJECT * motion.max()).nonzero()[:, 0]
        mobilities = jacobian[rows] @ compliance @ jacobian[rows].mT
        sizes = torch.linalg.matrix_norm(mobilities)
        usual, middle = float(sizes.median()), sizes.median(0).indices
        self.compliance, self.usual_gain = compliance.numpy(), FOLLOW / usual
        self.least_mobility = LEAST_FOLLOW * usual
        typical, mobility = operating_point.matter.every[rows[middle, None]], mobilities[middle]
        moved = [typical.moved_by(bodies).jacobian(rest)[0] for bodies in list_deviated(typical.bodies)]
        excess = [float(((J @ compliance @ J.mT - mobility) * mobility).sum()) / usual**2 for J in moved]
        self.excess = np.array(excess)
        changes = None if draws is None else measure_stiffness_spread(operating_point, draws[:MOST_LAWS])
        self.spread = np.zeros((0, *compliance.shape))
        if changes is not None:
            spread = -compliance @ torch.from_numpy(changes) @ compliance
            slope = jacobian[rows[middle]]
            share = (slope @ spread @ slope.mT * mobility).sum((1, 2)) / usual**2
            self.spread = (spread - share[:, None, None] * compliance).numpy() / np.sqrt(len(spread))

    def grasp(self, q: Vector, at: Point | Place) -> Grasp:
        """Grasp the matter around ``at`` [px] at the state ``q``, without pulling yet."""
        point, state = self.operating_point, torch.from_numpy(q)
        size = (point.height, point.width)
        held = grasp_brush(point.matter, state, at, radius=self.radius_px, size=size)
        jacobian = held.jacobian(state).numpy()
        answer = self.compliance @ jacobian.T
        mobility = jacobian @ answer
        moved = [held.points.moved_by(bodies) for bodies in list_deviated(held.points.bodies)]
        slopes = np.array([points.jacobian(state)[0].numpy() for points in moved]).reshape(
            -1, *jacobian.shape
        )
        of_motion = slopes @ self.compliance @ slopes.mT - (1.0 + self.excess)[:, None, None] * mobility
        spread = np.concatenate([jacobian @ self.spread @ jacobian.T, of_motion])
        gain = FOLLOW / max(float(np.linalg.norm(mobility)), self.least_mobility)
        return Grasp(held, gain, answer / self.farthest, mobility, spread, np.zeros(point.matter.space))
