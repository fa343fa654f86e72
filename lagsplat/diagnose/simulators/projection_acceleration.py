"""A sim that is given by its acceleration alone, as the mass, potential and so on that make it.

``M a + c(q, v) + C v + friction + dV/dq - b^T u = 0`` is linear in every coefficient; its scale is fixed by
``tr M_0 = d``. Terms are added as long as the acceleration gains by them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import PROJECTION_FIELDS
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.mechanics.basis import Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import (
    ModelStructure,
    build_candidate_bases,
    list_field_sizes,
    list_larger_structures,
)
from lagsplat.diagnose.simulators.projection import (
    EXACT_ERROR,
    ProjectedModel,
    build_friction_columns,
    compute_acceleration_error,
    finish_projection,
    make_symmetric_basis,
    rank_projection,
)

RIDGE = 1e-10
"""Of standardised columns: what the accelerations leave open stays at an inertia of one."""
MAX_ACCELERATION_DEGREE = {1: 7, 2: 5, 3: 3}


@dataclass(frozen=True)
class AccelerationTerms:
    """Forces (N, d, k) that a coefficient of one makes, field by field, for the largest form there may be."""

    basis: Basis
    region: OperatingRegion
    acceleration: Float64[np.ndarray, "N d"]
    mass: np.ndarray
    potential: np.ndarray
    damping: np.ndarray
    input_map: np.ndarray


def project_acceleration(
    acceleration: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    region: OperatingRegion,
    *,
    what: str,
) -> ProjectedModel:
    """The model of a sim whose ``acceleration(q, v, u)`` (N, d) is given; ``what`` names it in warnings.

    Accelerations alone leave open how inertia is shared between coordinates that do not act on one another,
    and with it what a force along one of them would do to the others; such a sim is given equal inertias.

    Raises:
        ValueError: the acceleration is not finite somewhere in the region, or zero everywhere.
    """
    known = acceleration(region.q, region.v, region.u)
    bad = ~np.isfinite(known).all(axis=1)
    if bad.any():
        n = int(np.argmax(bad))
        at = ", ".join(f"{k} = {getattr(region, k)[n].tolist()}" for k in ("q", "v", "u"))
        raise ValueError(
            f"{what}: the acceleration is not finite at {at}, which the recording comes near; check units "
            "and the range in which the sim is defined"
        )
    if not known.any():
        raise ValueError(f"{what}: the acceleration is zero everywhere; nothing would ever move")
    found = []
    for basis in reversed(build_candidate_bases(region.q, degree=MAX_ACCELERATION_DEGREE.get(region.d, 2))):
        found.append(_grow(_terms(basis, region, known)))
        if found[-1].error < EXACT_ERROR:
            break
    return finish_projection(min(found, key=rank_projection), what=what)


def _terms(basis: Basis, region: OperatingRegion, a: np.ndarray) -> AccelerationTerms:
    phi, slope, v = basis.values(region.q), basis.slopes(region.q), region.v
    n, d = region.q.shape
    pairs = make_symmetric_basis(d)
    push, energy = np.einsum("pij,nj->npi", pairs, v), np.einsum("ni,pij,nj->np", v, pairs, v)
    mass = np.einsum("nk,pij,nj->nikp", phi, pairs, a)
    mass += np.einsum("nkj,nj,npi->nikp", slope, v, push) - 0.5 * np.einsum("nki,np->nikp", slope, energy)
    drive = -np.einsum("nk,nc,ij->nikcj", phi, region.u, np.eye(d))
    return AccelerationTerms(
        basis, region, a, mass, slope[:, 1:].transpose(0, 2, 1),
        np.einsum("nk,npi->nikp", phi, push), drive.reshape(n, d, basis.size, -1),
    )  # fmt: skip


def _solve(terms: AccelerationTerms, form: ModelStructure, width: np.ndarray) -> MechanicalModel:
    """Coefficients of a form; those of the constant inertia have a trace of ``d``."""
    n, d = terms.acceleration.shape
    pairs, n_u = make_symmetric_basis(d), terms.region.n_u
    trace = np.einsum("pii->p", pairs)
    first = terms.mass[:, :, 0] - trace / d * (terms.mass[:, :, 0] @ trace)[..., None]
    blocks = [
        first,
        terms.mass[:, :, 1 : form.mass].reshape(n, d, -1),
        terms.damping[:, :, : form.damping].reshape(n, d, -1),
        terms.potential[:, :, : form.potential - 1],
        terms.input_map[:, :, : form.input_map].reshape(n, d, -1),
        build_friction_columns(terms.region.v, width if form.dry else None, form.drag),
    ]
    columns = np.concatenate(blocks, axis=2).reshape(n * d, -1)
    # an equation counts by the acceleration of its coordinate
    weight = np.tile(1.0 / (np.sqrt(np.mean(terms.acceleration**2, axis=0)) + 1e-12), n)
    known = -(terms.mass[:, :, 0] @ trace).reshape(-1)
    size = np.sqrt(np.mean((weight[:, None] * columns) ** 2, axis=0)) + 1e-30
    scaled = weight[:, None] * columns / size
    tail = np.sqrt(RIDGE * len(scaled)) * np.eye(len(size))
    x = np.linalg.lstsq(
        np.concatenate([scaled, tail]), np.concatenate([weight * known, np.zeros(len(size))]), rcond=None
    )[0] / size  # fmt: skip
    parts = np.split(x, np.cumsum([block.shape[2] for block in blocks])[:-1])
    heavy = np.concatenate([parts[0], parts[1]]).reshape(form.mass, -1)
    mass = np.einsum("kp,pij->kij", heavy, pairs)
    mass[0] += np.eye(d) * (1.0 - np.trace(mass[0]) / d)
    friction = parts[5]
    return MechanicalModel(
        terms.basis,
        mass,
        np.einsum("kp,pij->kij", parts[2].reshape(form.damping, -1), pairs),
        np.concatenate([[0.0], parts[3]]),
        parts[4].reshape(form.input_map, n_u, d),
        friction[:d] if form.dry else np.zeros(d),
        friction[-d:] if form.drag else np.zeros(d),
        width,
        np.median(terms.region.q, axis=0),
    )


def _grow(terms: AccelerationTerms) -> ProjectedModel:
    """From a linear system, by the step that helps the acceleration most."""
    region = terms.region
    speed, driven = np.maximum(region.speed, 1e-12), region.n_u > 0

    def tried(form: ModelStructure, ratio: float) -> tuple[float, ModelStructure, float, MechanicalModel]:
        model = _solve(terms, form, ratio * speed)
        return compute_acceleration_error(model, region, terms.acceleration), form, ratio, model

    def climb(
        best: tuple[float, ModelStructure, float, MechanicalModel],
    ) -> tuple[float, ModelStructure, float, MechanicalModel]:
        while best[0] > 0.1 * PROJECTION_FIELDS.tolerance:
            error, form, ratio, _ = best
            steps = [
                tried(larger, other)
                for larger in list_larger_structures(form, terms.basis, driven=driven)
                for other in (PROJECTION_FIELDS.friction_widths if larger.dry and not form.dry else (ratio,))
            ]
            # equals go to the smaller form
            step = min(
                steps, key=lambda row: (np.log10(row[0] + EXACT_ERROR).round(1), row[1].order), default=best
            )
            if step[0] > 0.8 * error and not (np.isinf(error) and np.isfinite(step[0])):
                break
            best = step
        return best

    one = 1 if driven else 0
    ends = list_field_sizes(terms.basis)
    best = climb(tried(ModelStructure(1, 1, ends[2], one), PROJECTION_FIELDS.default_friction_width))
    if (
        best[0] > PROJECTION_FIELDS.tolerance
    ):  # mass and potential that balance one another help only together
        jump = min(
            (
                tried(ModelStructure(end, 1, end, one), PROJECTION_FIELDS.default_friction_width)
                for end in ends[2:]
            ),
            key=lambda row: row[0],
        )
        best = climb(jump) if jump[0] < 0.5 * best[0] else best
    return ProjectedModel(best[3], best[0])
