"""A simulator that is given by its acceleration alone, written as a `MechanicalModel`.

``M a + c(q, v) + C v + friction + dV/dq - b^T u = 0`` is linear in every coefficient, and its scale is fixed
by ``tr M_0 = d``. Terms are added step by step as long as the error of the acceleration falls.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import PROJECTION
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.mechanics.basis import Basis
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
    ProjectedModel,
    build_friction_columns,
    build_inertial_columns,
    choose_projection,
    compute_acceleration_error,
)

RIDGE = 1e-10  # penalty in standardised columns, towards unit inertia where the accelerations leave it open
MAX_ACCELERATION_DEGREE = {1: 7, 2: 5, 3: 3}  # highest degree of the polynomials by number of coordinates


@dataclass(frozen=True)
class AccelerationTerms:
    """Generalised forces by a unit of each coefficient, field by field, for the largest structure."""

    basis: Basis
    region: OperatingRegion
    acceleration: Float64[np.ndarray, "N d"]
    mass: np.ndarray  # (N, d, K, P): by function and symmetric matrix
    potential: np.ndarray  # (N, d, K - 1): by function, without the constant
    damping: np.ndarray  # (N, d, K, P): by function and symmetric matrix
    input_map: np.ndarray  # (N, d, K, n_u d): by function, input and coordinate


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
    bad = ~np.isfinite(given).all(axis=1)
    if bad.any():
        n = int(np.argmax(bad))
        at = ", ".join(f"{k} = {getattr(region, k)[n].tolist()}" for k in ("q", "v", "u"))
        raise ValueError(
            f"{what}: the acceleration is not finite at {at}, which the recording comes near; check units "
            "and the range in which the sim is defined"
        )
    if not given.any():
        raise ValueError(f"{what}: the acceleration is zero everywhere; nothing would ever move")
    degree = MAX_ACCELERATION_DEGREE.get(region.d, 2)

    def project(basis: Basis) -> ProjectedModel:
        return _search_structure(_build_terms(basis, region, given))

    return choose_projection(project, region, max_degree=degree, what=what)


def _build_terms(basis: Basis, region: OperatingRegion, a: np.ndarray) -> AccelerationTerms:
    phi, slope, v = basis.values(region.q), basis.slopes(region.q), region.v
    n, d = region.q.shape
    pairs = make_symmetric_basis(d)
    mass = build_inertial_columns(phi, slope, v, a).reshape(n, d, basis.size, -1)
    drive = -np.einsum("nk,nc,ij->nikcj", phi, region.u, np.eye(d))
    damping, potential = np.einsum("nk,pij,nj->nikp", phi, pairs, v), slope[:, 1:].transpose(0, 2, 1)
    input_map = drive.reshape(n, d, basis.size, -1)
    return AccelerationTerms(basis, region, a, mass, potential, damping, input_map)


def _fit_coefficients(
    terms: AccelerationTerms, structure: ModelStructure, width: np.ndarray
) -> MechanicalModel:
    """The model of a structure by ridge regression, with a constant inertia of trace ``d``."""
    n, d = terms.acceleration.shape
    trace = np.einsum("pii->p", make_symmetric_basis(d))
    constant = terms.mass[:, :, 0] - trace / d * (terms.mass[:, :, 0] @ trace)[..., None]
    blocks = [
        np.concatenate([constant[:, :, None], terms.mass[:, :, 1 : structure.mass]], 2).reshape(n, d, -1),
        terms.damping[:, :, : structure.damping].reshape(n, d, -1),
        terms.potential[:, :, : structure.potential - 1],
        terms.input_map[:, :, : structure.input_map].reshape(n, d, -1),
        build_friction_columns(terms.region.v, width if structure.dry else None, structure.drag),
    ]
    columns = np.concatenate(blocks, axis=2).reshape(n * d, -1)
    # an equation is weighted by one over the root mean square acceleration of its coordinate
    weight = np.tile(1.0 / (np.sqrt(np.mean(terms.acceleration**2, axis=0)) + 1e-12), n)
    known = -(terms.mass[:, :, 0] @ trace).reshape(-1)
    size = np.sqrt(np.mean((weight[:, None] * columns) ** 2, axis=0)) + 1e-30
    scaled = weight[:, None] * columns / size
    tail = np.sqrt(RIDGE * len(scaled)) * np.eye(len(size))
    right = np.concatenate([weight * known, np.zeros(len(size))])
    x = np.linalg.lstsq(np.concatenate([scaled, tail]), right, rcond=None)[0] / size
    ends = np.cumsum([block.shape[2] for block in blocks])
    inertias, losses, potential, inputs, friction = np.split(x, ends[:-1])
    mass = sum_symmetric(inertias, d)
    mass[0] += np.eye(d) * (1.0 - np.trace(mass[0]) / d)
    damping, potential = sum_symmetric(losses, d), np.concatenate([[0.0], potential])
    input_map = inputs.reshape(structure.input_map, terms.region.n_u, d)
    dry = friction[:d] if structure.dry else np.zeros(d)
    drag = friction[-d:] if structure.drag else np.zeros(d)
    rest = np.median(terms.region.q, axis=0)
    return MechanicalModel(terms.basis, mass, damping, potential, input_map, dry, drag, width, rest)


def _search_structure(terms: AccelerationTerms) -> ProjectedModel:
    """Grow a linear model by the step with the least error of the acceleration, as long as it helps."""
    region = terms.region
    speed, driven = np.maximum(region.speed, 1e-12), region.n_u > 0

    def fit(structure: ModelStructure, width: float) -> _Candidate:
        model = _fit_coefficients(terms, structure, width * speed)
        error = compute_acceleration_error(model, region, terms.acceleration)
        return _Candidate(error, structure, width, model)

    def rank(candidate: _Candidate) -> tuple[float, tuple[int, ...]]:
        # of models with errors equal to a tenth of a decade the smaller one is taken
        return np.log10(candidate.error + EXACT_ERROR).round(1), candidate.structure.order

    def grow(best: _Candidate) -> _Candidate:
        while best.error > 0.1 * PROJECTION.tolerance:
            steps = []
            for larger in list_larger_structures(best.structure, terms.basis, driven=driven):
                first_dry = larger.dry and not best.structure.dry
                widths = PROJECTION.friction_widths if first_dry else (best.width,)
                steps += [fit(larger, width) for width in widths]
            step = min(steps, key=rank, default=best)
            if step.error > 0.8 * best.error and not (np.isinf(best.error) and np.isfinite(step.error)):
                break
            best = step
        return best

    n_input_map = 1 if driven else 0
    sizes, width = list_field_sizes(terms.basis), PROJECTION.default_friction_width
    best = grow(fit(ModelStructure(1, 1, sizes[2], n_input_map), width))
    if best.error > PROJECTION.tolerance:
        # a mass and a potential that balance each other help only together
        both = [fit(ModelStructure(size, 1, size, n_input_map), width) for size in sizes[2:]]
        start = min(both, key=lambda row: row.error)
        best = grow(start) if start.error < 0.5 * best.error else best
    return ProjectedModel(best.model, best.error)
