"""How far answers to forces spread over the laws that a recording allows as well."""

from contextlib import suppress

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.forces.equilibrium import settle
from lagsplat.forces.loads import Load, PointLoad, ScaledLoad
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.matter.field import MaterialPoints
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from lagsplat.stage2.likelihood.uncertainty import STEP

NUDGE = 1e-3  # relative change of a force from which the slope of its answer is taken
FEWEST = 10  # laws of which a spread is told


def measure_answer_spread(
    held: OperatingPoint,
    draws: Float64[np.ndarray, "m p"],
    load: Load,
    points: MaterialPoints,
    *,
    reference: PointLoad,
) -> Float64[np.ndarray, "B n n"] | None:
    """Covariance of the displacements [px^2] of points under a load, over drawn laws; None of too few.

    As a film does not tell the unit of forces, each law has an energy scale with which the pushed point of
    the ``reference`` goes as far along its way as under the most likely law. Laws a small step of the way to
    the drawn ones are solved, by the delta method. The error of the matter's motion is not counted.

    Args:
        held: the most likely law at rest.
        draws: parameters of laws (`lagsplat.stage2.fit.load_parameter_draws`).
        load: of ``B`` rows.
        points: one for each row.
        reference: a push of one row.
    """
    parameters = ParameterVector(held.law)
    theta, displaced = parameters.read(), []
    best = _displace(held, reference, reference.points)[0]
    nudged = _displace(held, ScaledLoad(reference, 1.0 + NUDGE), reference.points)[0]
    slope = float(((nudged - best) @ best) / (best @ best)) / NUDGE
    ways = _displace(held, load, points)
    try:
        for each in draws:
            parameters.write(theta + STEP * (torch.from_numpy(each) - theta))
            with suppress(ValueError, RuntimeError):  # a law without an equilibrium tells nothing
                answer = _displace(held, reference, reference.points)[0]
                excess = float(((answer - best) @ best) / (best @ best))
                scaled = ScaledLoad(load, 1.0 - excess / slope)
                displaced.append((_displace(held, scaled, points) - ways) / STEP)
    finally:
        parameters.write(theta)
    if len(displaced) < FEWEST:
        return None
    spread = torch.stack(displaced)
    return torch.einsum("mbi,mbj->bij", spread, spread).numpy() / len(spread)


def _displace(held: OperatingPoint, load: Load, points: MaterialPoints) -> Float[Tensor, "B n"]:
    """Displacement of the point of each row from rest under a law as it is now [px]."""
    u = held.u.expand(len(load), -1)
    rest = settle(held.law, held.u[None], start=held.rest)
    return points.carry_each(settle(held.law, u, load, start=held.rest)) - points.carry(rest)[0]
