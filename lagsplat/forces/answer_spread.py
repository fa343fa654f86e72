"""How far answers to forces spread over the laws and motions of matter that a recording allows as well."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.special import gammaincinv
from torch import Tensor

from lagsplat.forces.loaded_lagrangian import find_loaded_equilibria
from lagsplat.forces.loads import Load, PointLoad, ScaledLoad
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.matter.body_motion import BodyMotion, list_deviated
from lagsplat.matter.field import MaterialPoints
from lagsplat.stage2.equilibrium import compute_static_stiffness, find_equilibrium
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from lagsplat.stage2.likelihood.uncertainty import STEP

NUDGE = 1e-3  # relative change of a force from which the slope of its answer is taken
NO_EQUILIBRIUM = (ValueError, RuntimeError)  # of a law or a motion, which then tells nothing
FEWEST = 10  # laws of which a spread is told
# square of the half axes, in deviations, of an ellipse of such places
NINE_IN_TEN = float(2.0 * gammaincinv(1.0, 0.9))
LEAST_MOTION_PX = 1.0  # a smaller answer may spread by more than itself


def find_half_width(covariance: Float64[np.ndarray, "n n"]) -> float:
    """Half the long axis of the ellipse that holds a place nine times in ten [px]."""
    return float(np.sqrt(NINE_IN_TEN * max(0.0, np.linalg.eigvalsh(covariance)[-1])))


def is_undetermined(covariance: Float64[np.ndarray, "n n"], moved_px: float) -> bool:
    """Whether an answer spreads by more than itself, so that the recording does not determine it."""
    return find_half_width(covariance) > max(moved_px, LEAST_MOTION_PX)


def measure_answer_spread(
    point: OperatingPoint,
    draws: Float64[np.ndarray, "m p"],
    load: Load,
    points: MaterialPoints,
    *,
    reference: PointLoad,
) -> Float64[np.ndarray, "B n n"] | None:
    """Covariance of the displacements [px^2] of points under a load; None where too few laws were drawn.

    It is that over drawn laws, by the delta method, and that over deviations of the matter's motion. As a
    film does not tell the unit of forces, each law has an energy scale with which the pushed point of the
    ``reference`` goes as far along its way as under the most likely law.

    Args:
        point: the most likely law at rest.
        draws: parameters of laws (`lagsplat.stage2.fit.load_parameter_draws`).
        load: of ``B`` rows.
        points: one for each row.
        reference: a push of one row.
    """
    rest, poked, loaded = (_find_equilibria(point, each, point.rest) for each in (None, reference, load))
    best = _displace(reference.points, poked, rest)[0]
    stronger = ScaledLoad(reference, 1.0 + NUDGE)
    nudged = _displace(reference.points, _find_equilibria(point, stronger, poked), rest)[0]

    def find_excess(displacement: Float[Tensor, " n"]) -> float:
        """How much further than the most likely law's the pushed point went, along its way [share]."""
        return float(((displacement - best) @ best) / (best @ best))

    slope = find_excess(nudged) / NUDGE
    ways = _displace(points, loaded, rest)

    def measure(bodies: tuple[BodyMotion, ...]) -> Float[Tensor, "B n"]:
        # equilibria of a law so near start from those of the most likely one, whose branch they are on
        own, poke = _find_equilibria(point, None, rest), reference.moved_by(bodies)
        moved = _displace(poke.points, _find_equilibria(point, poke, poked), own)[0]
        scaled = ScaledLoad(load.moved_by(bodies), 1.0 - find_excess(moved) / slope)
        return _displace(points.moved_by(bodies), _find_equilibria(point, scaled, loaded), own) - ways

    over_laws = _measure_over_laws(point, draws, lambda: measure(point.matter.bodies))
    if over_laws is None:
        return None
    changes = list(over_laws / len(over_laws) ** 0.5)
    for bodies in list_deviated(point.matter.bodies):
        with suppress(*NO_EQUILIBRIUM):
            changes.append(measure(bodies))
    spread = torch.stack(changes)
    return torch.einsum("mbi,mbj->bij", spread, spread).numpy()


def measure_stiffness_spread(
    point: OperatingPoint, draws: Float64[np.ndarray, "m p"]
) -> Float64[np.ndarray, "k d d"] | None:
    """Changes of the static stiffness at rest over drawn laws [energy], by the delta method; None of too few.

    Args:
        point: the most likely law at rest.
        draws: parameters of laws (`lagsplat.stage2.fit.load_parameter_draws`).
    """

    def compute() -> Float[Tensor, "d d"]:
        rest = find_equilibrium(point.law, point.u, point.rest)
        return compute_static_stiffness(point.law, rest[None], point.u[None])[0]

    usual = compute()
    changes = _measure_over_laws(point, draws, lambda: compute() - usual)
    return None if changes is None else changes.numpy()


def _measure_over_laws(
    point: OperatingPoint, draws: Float64[np.ndarray, "m p"], measure: Callable[[], Tensor]
) -> Float[Tensor, "k ..."] | None:
    """Changes that laws a small step of the way to the drawn ones make, per step; the law is restored."""
    parameters = ParameterVector(point.law)
    theta, changes = parameters.read(), []
    try:
        for each in draws:
            parameters.write(theta + STEP * (torch.from_numpy(each) - theta))
            with suppress(*NO_EQUILIBRIUM):
                changes.append(measure() / STEP)
    finally:
        parameters.write(theta)
    return torch.stack(changes) if len(changes) >= FEWEST else None


def _find_equilibria(point: OperatingPoint, load: Load | None, start: Tensor) -> Float[Tensor, "B d"]:
    """Equilibria under each row of a load, or at rest, under a law as it is now."""
    inputs = point.u.expand(1 if load is None else len(load), -1)
    return find_loaded_equilibria(point.law, inputs, load, start=start)


def _displace(
    points: MaterialPoints, states: Float[Tensor, "B d"], rest: Float[Tensor, "1 d"]
) -> Float[Tensor, "B n"]:
    """Displacement of the point of each row from rest [px]."""
    return points.carry_each(states) - points.carry(rest)[0]
