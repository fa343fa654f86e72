"""A simulator that is given by its acceleration alone, written as a `MechanicalModel`.

``M a + c(q, v) + C v + friction + dV/dq - b^T u = 0`` is linear in every coefficient, and its scale is fixed
by ``tr M_0 = d``. Terms are added step by step as long as the error of the acceleration falls.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lagsplat.diagnose.core.config import PROJECTION
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import (
    ModelStructure,
    list_field_sizes,
    list_larger_structures,
    make_symmetric_basis,
    sum_symmetric,
)
from lagsplat.diagnose.simulators.projection import (
    EXACT_ERROR,
    ForceColumns,
    ProjectedModel,
    build_friction_columns,
    choose_projection,
    compute_acceleration_error,
    require_finite,
)

RIDGE = 1e-10  # penalty in standardised columns, towards unit inertia where the accelerations leave it open
MAX_ACCELERATION_DEGREE = {1: 7, 2: 5, 3: 3}  # highest degree of the polynomials by number of coordinates


class _Candidate(NamedTuple):
    """A model of a certain structure and its relative error of the acceleration."""

    error: float
    structure: ModelStructure
    width: float  # width of dry friction, relative to the root mean square speed
    model: MechanicalModel


def project_acceleration(
    acceleration: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    region: OperatingRegion,
    *,
    what: str,
) -> ProjectedModel:
    """The model of a simulator with a given ``acceleration(q, v, u)`` (N, d); ``what`` names it in messages.

    Accelerations alone do not determine the ratio of the inertias of coordinates that do not act on each
    other, and with it the effect of a force on both; such coordinates get equal inertias.

    Raises:
        ValueError: the acceleration is not finite somewhere in the region, or zero everywhere.
    """
    given = acceleration(region.q, region.v, region.u)
    require_finite(given, region, f"{what}: the acceleration")
    if not given.any():
        raise ValueError(f"{what}: the acceleration is zero everywhere; nothing would ever move")
    degree = MAX_ACCELERATION_DEGREE.get(region.d, 2)
    return choose_projection(_search_structure, region, given, max_degree=degree, what=what)


def _fit_coefficients(forces: ForceColumns, structure: ModelStructure, width: np.ndarray) -> MechanicalModel:
    """The model of a structure by ridge regression, with a constant inertia of trace ``d``."""
    u = forces.region.u
    n, d = forces.acceleration.shape
    trace = np.einsum("pii->p", make_symmetric_basis(d))
    mean_inertia = forces.mass[:, :, 0] @ trace
    constant = forces.mass[:, :, 0] - trace / d * mean_inertia[..., None]
    drive = -forces.input_map[:, :, : structure.input_map, None] * u[:, None, None, :, None]
    blocks = [
        np.concatenate([constant[:, :, None], forces.mass[:, :, 1 : structure.mass]], 2).reshape(n, d, -1),
        forces.damping[:, :, : structure.damping].reshape(n, d, -1),
        forces.potential[:, :, : structure.potential - 1],
        drive.reshape(n, d, structure.input_map * u.shape[1] * d),
        build_friction_columns(forces.region.v, width if structure.dry else None, structure.drag),
    ]
    columns = np.concatenate(blocks, axis=2).reshape(n * d, -1)
    # an equation is weighted by one over the root mean square acceleration of its coordinate
    weight = np.tile(1.0 / (np.sqrt(np.mean(forces.acceleration**2, axis=0)) + 1e-12), n)
    size = np.sqrt(np.mean((weight[:, None] * columns) ** 2, axis=0)) + 1e-30
    scaled = weight[:, None] * columns / size
    tail = np.sqrt(RIDGE * len(scaled)) * np.eye(len(size))
    right = np.concatenate([weight * -mean_inertia.reshape(-1), np.zeros(len(size))])
    x = np.linalg.lstsq(np.concatenate([scaled, tail]), right, rcond=None)[0] / size
    ends = np.cumsum([block.shape[2] for block in blocks])
    inertias, losses, potential, inputs, friction = np.split(x, ends[:-1])
    mass, damping, potential = sum_symmetric(inertias, d), sum_symmetric(losses, d), np.append(0.0, potential)
    mass[0] += np.eye(d) * (1.0 - np.trace(mass[0]) / d)
    input_map = inputs.reshape(structure.input_map, u.shape[1], d)
    dry = friction[:d] if structure.dry else np.zeros(d)
    drag = friction[-d:] if structure.drag else np.zeros(d)
    rest = np.median(forces.region.q, axis=0)
    return MechanicalModel(forces.basis, mass, damping, potential, input_map, dry, drag, width, rest)


def _search_structure(forces: ForceColumns) -> MechanicalModel:
    """Grow a linear model by the step with the least error of the acceleration, as long as it helps."""
    region = forces.region
    speed, driven = np.maximum(region.speed, 1e-12), region.n_u > 0

    def fit(structure: ModelStructure, width: float) -> _Candidate:
        model = _fit_coefficients(forces, structure, width * speed)
        error = compute_acceleration_error(model, region, forces.acceleration)
        return _Candidate(error, structure, width, model)

    def rank(candidate: _Candidate) -> tuple[float, tuple[int, ...]]:
        # of models with errors equal to a tenth of a decade the smaller one is taken
        return np.log10(candidate.error + EXACT_ERROR).round(1), candidate.structure.order

    def grow(best: _Candidate) -> _Candidate:
        while best.error > 0.1 * PROJECTION.tolerance:
            steps = []
            for larger in list_larger_structures(best.structure, forces.basis, driven=driven):
                first_dry = larger.dry and not best.structure.dry
                widths = PROJECTION.friction_widths if first_dry else (best.width,)
                steps += [fit(larger, width) for width in widths]
            step = min(steps, key=rank, default=best)
            if step.error > 0.8 * best.error and not (np.isinf(best.error) and np.isfinite(step.error)):
                break
            best = step
        return best

    n_input_map = 1 if driven else 0
    sizes, width = list_field_sizes(forces.basis), PROJECTION.default_friction_width
    best = grow(fit(ModelStructure(1, 1, sizes[2], n_input_map), width))
    if best.error > PROJECTION.tolerance:
        # a mass and a potential that balance each other help only together
        both = [fit(ModelStructure(size, 1, size, n_input_map), width) for size in sizes[2:]]
        start = min(both, key=lambda row: row.error)
        best = grow(start) if start.error < 0.5 * best.error else best
    return best.model
