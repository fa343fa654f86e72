"""A simulator whose mass, potential and so on are given point by point, written as a `MechanicalModel`.

Each field is fitted on its own by least squares over the recorded region, in as few basis functions as
suffice. The error that is minimised is that of the acceleration and not of the force: where inertias differ
by orders of magnitude, a small error of a large force would be a large acceleration of a light coordinate.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np
from jaxtyping import Float64
from scipy.linalg import lstsq
from scipy.optimize import root

from lagsplat.diagnose.core.config import PROJECTION
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.identification.novelty import KnownRegion
from lagsplat.diagnose.mechanics.basis import Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import (
    build_candidate_bases,
    list_field_sizes,
    make_symmetric_basis,
    sum_symmetric,
)

EXACT_ERROR = 1e-6  # relative, of the acceleration, below which a projection is exact but for rounding
MAX_DEGREE = {1: 9, 2: 8, 3: 4}  # highest degree of the polynomials by number of coordinates


@dataclass(frozen=True)
class FieldFunctions:
    """Fields of ``M(q) a + c(q, v) + dissipation(q, v) + dV/dq = input_map(q)^T u``, for N points at once.

    ``c`` follows from ``M``. Forces may have any unit.
    """

    mass: Callable[[np.ndarray], np.ndarray]  # (N, d) to (N, d, d)
    potential_gradient: Callable[[np.ndarray], np.ndarray]  # gradient of the potential, (N, d) to (N, d)
    input_map: Callable[[np.ndarray], np.ndarray]  # (N, d) to (N, n_u, d)
    dissipation: Callable[[np.ndarray, np.ndarray], np.ndarray]  # of q and v, to (N, d)

    def coriolis(self, q: np.ndarray, v: np.ndarray) -> Float64[np.ndarray, "N d"]:
        """Coriolis and centrifugal forces ``M' v - d(v.M v / 2)/dq``, by central differences of the mass."""
        reach = np.maximum(np.ptp(q, axis=0), 1e-6)
        force = np.zeros_like(q)
        for i, step in enumerate(1e-4 * np.diag(reach)):
            slope = (self.mass(q + step) - self.mass(q - step)) / (2.0 * step[i])
            slope_v = np.einsum("nab,nb->na", slope, v)
            force += v[:, i, None] * slope_v
            force[:, i] -= 0.5 * np.einsum("na,na->n", v, slope_v)
        return force


@dataclass(frozen=True)
class ProjectedModel:
    """A model that stands for a given simulator over a region."""

    model: MechanicalModel
    error: float  # root mean square error of its acceleration, relative to that of the acceleration itself
    known_region: KnownRegion | None = None  # in which the simulator was fitted, if it was


@dataclass(frozen=True)
class ForceColumns:
    """Forces at points of a region by a unit of each coefficient of the fields, where these accelerate so."""

    basis: Basis
    region: OperatingRegion
    acceleration: Float64[np.ndarray, "N d"]
    mass: np.ndarray  # ``M a + c`` (N, d, K, P): by function and symmetric matrix
    potential: np.ndarray  # (N, d, K - 1): by function, without the constant
    damping: np.ndarray  # (N, d, K, P): by function and symmetric matrix
    input_map: np.ndarray  # (N, d, K, d): by function and coordinate, of an input of 1


def project_fields(
    mechanics: FieldFunctions, region: OperatingRegion, *, what: str, max_degree: int | None = None
) -> ProjectedModel:
    """The model of a simulator whose mass, potential, damping and input map are given.

    ``what`` names it in messages, ``max_degree`` is the highest degree of its polynomials.

    Raises:
        ValueError: a field is not finite in the region, or the mass matrix is not positive there.
    """
    samples = _evaluate_fields(mechanics, region, what)
    degree = MAX_DEGREE.get(region.d, 3) if max_degree is None else max_degree
    return choose_projection(
        partial(_fit_fields, samples), region, samples.acceleration, max_degree=degree, what=what
    )


def choose_projection(
    fit: Callable[[ForceColumns], MechanicalModel],
    region: OperatingRegion,
    acceleration: Float64[np.ndarray, "N d"],
    *,
    max_degree: int,
    what: str,
) -> ProjectedModel:
    """The smallest projection that is accurate enough, of those that ``fit`` gives in all candidate bases.

    It has its rest. A warning tells if its acceleration in the region is not the given one.
    """
    candidates = []
    for basis in reversed(build_candidate_bases(region.q, degree=max_degree)):
        model = fit(build_force_columns(basis, region, acceleration))
        candidates.append(ProjectedModel(model, compute_acceleration_error(model, region, acceleration)))
        if candidates[-1].error < EXACT_ERROR:
            break
    best = min(candidates, key=_rank)
    if best.error > PROJECTION.warning_error:
        warnings.warn(
            f"{what}: its acceleration could be written in mass, damping, potential and inputs only to "
            f"within {100.0 * best.error:.1f} % over the region of the recording; what is missing (a "
            "contact, a limit, an input that does not act linearly) may be taken for an effect",
            stacklevel=3,
        )
    model = best.model.trim_basis()
    return ProjectedModel(replace(model, rest=find_rest(model)), best.error)


def _rank(candidate: ProjectedModel) -> tuple[int, float]:
    """Sort key: exact models first, then accurate ones by their size, then the rest by their error."""
    if candidate.error < PROJECTION.tolerance:
        model = candidate.model
        size = model.mass.size + model.potential.size + model.damping.size + model.input_map.size
        return int(candidate.error > EXACT_ERROR), size
    return 2, candidate.error


@dataclass(frozen=True)
class FieldSamples:
    """The given fields at the points of a region, shaped as the results of `FieldFunctions`."""

    region: OperatingRegion
    mass: np.ndarray
    coriolis: np.ndarray
    potential_gradient: np.ndarray
    input_map: np.ndarray
    dissipation: np.ndarray

    @cached_property
    def acceleration(self) -> Float64[np.ndarray, "N d"]:
        """The acceleration that the fields prescribe at every point."""
        drive = np.einsum("nci,nc->ni", self.input_map, self.region.u)
        force = drive - self.potential_gradient - self.coriolis - self.dissipation
        return np.linalg.solve(self.mass, force[..., None])[..., 0]

    @cached_property
    def weight(self) -> Float64[np.ndarray, "N d d"]:
        """Maps a force to accelerations in units of each coordinate's root mean square acceleration."""
        return np.linalg.inv(self.mass) / measure_size(self.acceleration)[:, None]

    def share(self, forces: np.ndarray) -> np.ndarray:
        """Relative accelerations (N, d, k) by columns of forces (N, d, ...)."""
        columns = forces.reshape(*self.acceleration.shape, -1)
        return np.einsum("nij,njk->nik", self.weight, columns, optimize=True)


def measure_size(acceleration: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, " d"]:
    """Root mean square of each coordinate, floored so that one that rests can be divided by."""
    size = np.sqrt(np.mean(acceleration**2, axis=0))
    return np.maximum(size, 1e-9 * size.max() + 1e-300)


def _evaluate_fields(mechanics: FieldFunctions, region: OperatingRegion, what: str) -> FieldSamples:
    q, v = region.q, region.v
    samples = FieldSamples(
        region,
        mechanics.mass(q),
        mechanics.coriolis(q, v),
        mechanics.potential_gradient(q),
        mechanics.input_map(q),
        mechanics.dissipation(q, v),
    )
    for name in ("mass", "coriolis", "potential_gradient", "input_map", "dissipation"):
        require_finite(getattr(samples, name), region, f"{what}: {name}")
    lowest = np.linalg.eigvalsh(samples.mass)[:, 0]
    if lowest.min() <= 0.0:
        at = np.array2string(q[np.argmin(lowest)], precision=4)
        raise ValueError(
            f"{what}: the mass matrix is not positive at q = {at} (eigenvalue {lowest.min():.3g}); "
            "a coordinate without inertia cannot be simulated"
        )
    return samples


def require_finite(values: np.ndarray, region: OperatingRegion, what: str) -> None:
    """Check the values (N, ...) that a simulator gives at the points of a region.

    Raises:
        ValueError: a value is not finite; the message names ``what`` it is of, and where.
    """
    bad = ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
    if bad.any():
        n = int(np.argmax(bad))
        at = ", ".join(f"{k} = {np.array2string(getattr(region, k)[n], precision=4)}" for k in "qvu")
        raise ValueError(
            f"{what} is not finite at {at}, which the recording comes near; check units and the range in "
            "which the sim is defined"
        )


def _fit_fields(samples: FieldSamples, columns: ForceColumns) -> MechanicalModel:
    """Fit every field with the smallest number of functions that is accurate enough."""
    d, region, sizes = columns.region.d, columns.region, list_field_sizes(columns.basis)
    fit = partial(_fit_smallest, samples)
    inertial = np.einsum("nij,nj->ni", samples.mass, samples.acceleration) + samples.coriolis
    mass = sum_symmetric(fit(columns.mass, inertial, sizes), d)
    slopes = fit(columns.potential, samples.potential_gradient, [k - 1 for k in sizes[2:]])
    potential = np.append(0.0, slopes)
    input_map = np.zeros((0, region.n_u, d))
    if region.n_u:
        gains = fit(columns.input_map, samples.input_map.transpose(0, 2, 1), sizes, region.u)
        input_map = gains.reshape(-1, d, region.n_u).transpose(0, 2, 1)
    damping, dry, drag, width = _fit_dissipation(samples, columns.damping, sizes)
    # the motion leaves the scale of all fields open: inertia is counted in units of its mean
    unit = float(np.trace(mass[0])) / d
    unit = unit if unit > 0.0 else float(np.mean(np.trace(samples.mass, axis1=1, axis2=2))) / d
    mass, damping, potential = mass / unit, damping / unit, potential / unit
    input_map, dry, drag = input_map / unit, dry / unit, drag / unit
    rest = np.median(region.q, axis=0)
    return MechanicalModel(columns.basis, mass, damping, potential, input_map, dry, drag, width, rest)


def _fit_dissipation(
    samples: FieldSamples, damping_columns: np.ndarray, sizes: list[int]
) -> tuple[np.ndarray, ...]:
    """Damping, dry friction, drag and friction width: the smallest set that is accurate enough."""
    v, d, speed = samples.region.v, samples.region.d, np.maximum(samples.region.speed, 1e-12)
    viscous, wanted = samples.share(damping_columns), samples.share(samples.dissipation)
    options = [
        (width, drag, samples.share(build_friction_columns(v, width, drag)))
        for drag in (False, True)
        for width in (None, *(width * speed for width in PROJECTION.friction_widths))
    ]
    lowest = np.inf
    for size, (width, drag, friction) in product(sizes, options):
        n = size * d * (d + 1) // 2
        columns = np.concatenate([viscous[:, :, :n], friction], axis=2)
        x = _solve_least_squares(columns, wanted)
        error = _measure_error((columns @ x - wanted)[..., 0])
        if error < 0.8 * lowest:  # more terms must gain a fifth at least
            lowest, best, best_width, has_drag = error, np.split(x[:, 0], [n]), width, drag
        if lowest < 0.1 * PROJECTION.tolerance:
            break
    damping, rest = best
    dry = np.zeros(d) if best_width is None else rest[:d]
    quadratic = rest[-d:] if has_drag else np.zeros(d)
    if best_width is None:
        best_width = PROJECTION.default_friction_width * speed
    return sum_symmetric(damping, d), dry, quadratic, best_width


def _fit_smallest(
    samples: FieldSamples,
    forces: np.ndarray,
    wanted: np.ndarray,
    sizes: list[int],
    amounts: Float64[np.ndarray, "N r"] | None = None,
) -> Float64[np.ndarray, "k r"]:
    """The coefficients of the fewest functions whose error is a tenth of the tolerance, or the best.

    ``forces`` (N, d, K, ...) are by function, ``wanted`` (N, d, r) what they should be, ``sizes`` numbers of
    functions, and ``amounts`` how much of each of the r acts at a point, by default 1.
    """
    columns, wanted = samples.share(forces), samples.share(wanted)
    best, lowest = np.zeros((0, wanted.shape[2])), np.inf
    for size in sizes:
        first = columns[:, :, : size * columns.shape[2] // forces.shape[2]]
        x = _solve_least_squares(first, wanted)
        wrong = first @ x - wanted
        error = _measure_error(wrong[..., 0] if amounts is None else np.einsum("nir,nr->ni", wrong, amounts))
        if error < 0.9 * lowest:  # more functions must gain a tenth at least
            best, lowest = x, error
        if error < 0.1 * PROJECTION.tolerance:
            break
    return best


def _measure_error(wrong: Float64[np.ndarray, "N d"]) -> float:
    """Root mean square of relative accelerations, the largest of all coordinates."""
    return float(np.max(np.sqrt(np.mean(wrong**2, axis=0))))


def _solve_least_squares(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least-squares solution (k, r) of ``left x = right`` for ``left`` (N, d, k) and ``right`` (N, d, r)."""
    flat = left.reshape(-1, left.shape[2])
    return lstsq(flat, right.reshape(len(flat), -1), cond=1e-12, lapack_driver="gelsy")[0]


def build_force_columns(
    basis: Basis, region: OperatingRegion, acceleration: Float64[np.ndarray, "N d"]
) -> ForceColumns:
    """The forces of all functions of a basis."""
    phi, slopes, v = basis.values(region.q), basis.slopes(region.q), region.v
    pairs = make_symmetric_basis(region.d)
    matrix_a, matrix_v = (np.einsum("pij,nj->npi", pairs, x) for x in (acceleration, v))
    rate = np.einsum("nki,ni->nk", slopes, v)
    mass = np.einsum("nk,npi->nikp", phi, matrix_a) + np.einsum("nk,npi->nikp", rate, matrix_v)
    mass -= 0.5 * np.einsum("nki,np->nikp", slopes, np.einsum("npi,ni->np", matrix_v, v))
    return ForceColumns(
        basis,
        region,
        acceleration,
        mass,
        slopes[:, 1:].transpose(0, 2, 1),
        np.einsum("nk,pij,nj->nikp", phi, pairs, v),
        np.einsum("nk,ij->nikj", phi, np.eye(region.d)),
    )


def build_friction_columns(v: Float64[np.ndarray, "N d"], width: np.ndarray | None, drag: bool) -> np.ndarray:
    """Columns (N, d, k) of dry friction of ``width`` (d,), if any, and of drag, one for each coordinate."""
    parts = [] if width is None else [np.tanh(v / width)]
    parts += [np.abs(v) * v] if drag else []
    return np.concatenate([p[:, :, None] * np.eye(v.shape[1]) for p in parts] or [np.zeros((*v.shape, 0))], 2)


def compute_acceleration_error(
    model: MechanicalModel, region: OperatingRegion, acceleration: Float64[np.ndarray, "N d"]
) -> float:
    """Root mean square error of the model's acceleration, relative to that of the given ``acceleration``.

    The largest of all coordinates. A model whose mass is not positive everywhere has an infinite error.
    """
    eigenvalues = np.linalg.eigvalsh(model.mass_at(region.q))
    if eigenvalues.min() < 1e-4 * eigenvalues.max():
        return float("inf")
    wrong = model.acceleration(region.q, region.v, region.u) - acceleration
    return float(np.max(np.sqrt(np.mean(wrong**2, axis=0)) / measure_size(acceleration)))


def find_rest(model: MechanicalModel) -> Float64[np.ndarray, " d"]:
    """A stable equilibrium of the unloaded model within its region; the model's present ``rest`` if none."""
    low, high = model.basis.centre - model.basis.scale, model.basis.centre + model.basis.scale
    size = float(np.abs(model.spring(np.stack([low, high]))).max()) + 1e-300
    for start in (model.rest, model.basis.centre, 0.5 * (low + model.rest), 0.5 * (high + model.rest)):
        solution = root(lambda q: model.spring(q[None])[0] / size, start)
        q = np.asarray(solution.x, dtype=np.float64)
        inside = bool((q >= low).all() and (q <= high).all())
        if inside and np.abs(model.spring(q[None])).max() < 1e-6 * size:
            stiffness = replace(model, rest=q).stiffness
            if np.linalg.eigvalsh(stiffness).min() > 0.0:
                return q
    return model.rest
