"""A sim that is given point by point, as mass, slope of the potential and so on, in the basis of a
`MechanicalModel`.

How each field is fitted is told in `lagsplat.diagnose.simulators.projection`.

The fields of a sim that is given point by point, each in as few functions of a basis as serve.

Each is fitted alone by least squares over the region that was visited. What is made small is the error of the
acceleration, not of the force: where inertias differ by far, a small error in a large force flings what is
light.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.linalg import lstsq
from scipy.optimize import root

from lagsplat.diagnose.core.config import PROJECTION, PROJECTION_FIELDS
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.mechanics.basis import Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import build_candidate_bases, list_field_sizes

EXACT_ERROR = 1e-6
"""Relative error of the acceleration below which a projection counts as exact: rounding of a regression."""
MAX_DEGREE = {1: 9, 2: 8, 3: 4}
"""Highest degree of the polynomials by number of coordinates."""


@dataclass(frozen=True)
class FieldFunctions:
    """``M(q) a + c(q, v) + loss(q, v) + slope(q) = input_map(q)^T u`` as functions of many points at once.

    ``c`` is the one that belongs to ``M``. Any unit of force serves.
    """

    mass: Callable[[np.ndarray], np.ndarray]
    """(N, d) to (N, d, d)."""
    slope: Callable[[np.ndarray], np.ndarray]
    """Gradient of the potential, (N, d) to (N, d)."""
    input_map: Callable[[np.ndarray], np.ndarray]
    """(N, d) to (N, n_u, d)."""
    loss: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """Damping and friction, from ``q`` and ``v`` (N, d) to (N, d)."""

    def turning(self, q: np.ndarray, v: np.ndarray) -> Float64[np.ndarray, "N d"]:
        """``M' v - d(v.M v / 2)/dq``, by central differences of the mass."""
        reach = np.maximum(np.ptp(q, axis=0), 1e-6)
        out = np.zeros_like(q)
        for i, step in enumerate(1e-4 * np.diag(reach)):
            slope = (self.mass(q + step) - self.mass(q - step)) / (2.0 * step[i])
            push = np.einsum("nab,nb->na", slope, v)
            out += v[:, i, None] * push
            out[:, i] -= 0.5 * np.einsum("na,na->n", v, push)
        return out

    def acceleration(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> Float64[np.ndarray, "N d"]:
        """What the mechanics prescribe at every point."""
        drive = np.einsum("nci,nc->ni", self.input_map(q), u)
        force = drive - self.slope(q) - self.turning(q, v) - self.loss(q, v)
        return np.linalg.solve(self.mass(q), force[..., None])[..., 0]


@dataclass(frozen=True)
class ProjectedModel:
    """A model, and the error of its acceleration over the region, relative to the acceleration's own size."""

    model: MechanicalModel
    error: float


def project_fields(mechanics: FieldFunctions, region: OperatingRegion, *, what: str) -> ProjectedModel:
    """The model of a sim whose mass, potential, damping and input map are given; ``what`` names it to people.

    Raises:
        ValueError: a field is not finite in the region, or the mass matrix is not positive there.
    """
    seen = _look(mechanics, region, what)
    found = []
    for basis in reversed(build_candidate_bases(region.q, degree=MAX_DEGREE.get(region.d, 3))):
        model = fit_fields(seen, basis)
        found.append(ProjectedModel(model, compute_acceleration_error(model, region, seen.acceleration)))
        if found[-1].error < EXACT_ERROR:
            break
    return finish_projection(min(found, key=rank_projection), what=what)


def compute_acceleration_error(
    model: MechanicalModel, region: OperatingRegion, acceleration: Float64[np.ndarray, "N d"]
) -> float:
    """Root mean square of the error of the model's acceleration, in units of that of the acceleration itself.

    The worst coordinate counts. A model whose mass is not positive everywhere has an infinite error.
    """
    eigenvalues = np.linalg.eigvalsh(model.mass_at(region.q))
    if eigenvalues.min() < 1e-4 * eigenvalues.max():
        return float("inf")
    wrong = model.acceleration(region.q, region.v, region.u) - acceleration
    size = np.sqrt(np.mean(acceleration**2, axis=0))
    return float(np.max(np.sqrt(np.mean(wrong**2, axis=0)) / np.maximum(size, 1e-9 * size.max() + 1e-300)))


def rank_projection(one: ProjectedModel) -> tuple[int, float]:
    """To be minimised: exact ones first, then the smallest that is good, then the least bad."""
    if one.error < PROJECTION_FIELDS.tolerance:
        m = one.model
        return int(
            one.error > EXACT_ERROR
        ), m.mass.size + m.potential.size + m.damping.size + m.input_map.size
    return 2, one.error


def finish_projection(one: ProjectedModel, *, what: str) -> ProjectedModel:
    """The same, cut to the functions it uses and with its point of rest; warns where it is poor."""
    if one.error > PROJECTION.warning_error:
        warnings.warn(
            f"{what}: its acceleration could be written in mass, damping, potential and inputs only to "
            f"within {100.0 * one.error:.1f} % over the region of the recording; what is missing (a "
            "contact, a limit, an input that does not act linearly) may be taken for an effect",
            stacklevel=3,
        )
    model = one.model
    size = max(len(model.mass), len(model.damping), len(model.potential), len(model.input_map))
    model = replace(model, basis=model.basis.first(size))
    return replace(one, model=replace(model, rest=find_rest(model)))


def find_rest(model: MechanicalModel) -> Float64[np.ndarray, " d"]:
    """Where the unloaded model rests stably within its region; the model's own ``rest`` if nowhere."""
    low, high = model.basis.centre - model.basis.scale, model.basis.centre + model.basis.scale
    size = float(np.abs(model.spring(np.stack([low, high]))).max()) + 1e-300
    for start in (model.rest, model.basis.centre, 0.5 * (low + model.rest), 0.5 * (high + model.rest)):
        found = root(lambda q: model.spring(q[None])[0] / size, start)
        at = np.asarray(found.x, dtype=np.float64)
        inside = bool((at >= low).all() and (at <= high).all())
        if inside and np.abs(model.spring(at[None])).max() < 1e-6 * size:
            here = replace(model, rest=at)
            if np.linalg.eigvalsh(here.stiffness).min() > 0.0:
                return at
    return model.rest


@dataclass(frozen=True)
class FieldSamples:
    """Fields at the points of a region, and what a force there accelerates."""

    region: OperatingRegion
    mass: np.ndarray
    turning: np.ndarray
    slope: np.ndarray
    input_map: np.ndarray
    loss: np.ndarray
    acceleration: np.ndarray

    @cached_property
    def weight(self) -> Float64[np.ndarray, "N d d"]:
        """What turns a force into its share of each coordinate's usual acceleration."""
        size = np.sqrt(np.mean(self.acceleration**2, axis=0))
        return np.linalg.inv(self.mass) / np.maximum(size, 1e-9 * size.max() + 1e-300)[:, None]

    def share(self, forces: np.ndarray) -> np.ndarray:
        """``weight`` applied to columns of forces (N, d, k)."""
        return np.einsum("nij,njk->nik", self.weight, forces, optimize=True)

    def error(self, wrong: np.ndarray) -> float:
        """Size of what a wrong force (N, d) accelerates, relative to the usual acceleration."""
        return float(np.max(np.sqrt(np.mean(self.share(wrong[..., None]) ** 2, axis=(0, 2)))))


def _look(mechanics: FieldFunctions, region: OperatingRegion, what: str) -> FieldSamples:
    q, v = region.q, region.v
    seen = FieldSamples(
        region, mechanics.mass(q), mechanics.turning(q, v), mechanics.slope(q), mechanics.input_map(q),
        mechanics.loss(q, v), np.zeros_like(q),
    )  # fmt: skip
    for name in ("mass", "turning", "slope", "input_map", "loss"):
        bad = ~np.isfinite(getattr(seen, name)).reshape(len(q), -1).all(axis=1)
        if bad.any():
            at = np.array2string(q[np.argmax(bad)], precision=4)
            raise ValueError(
                f"{what}: {name} is not finite at q = {at}, which the recording comes near; check units and "
                "the range in which the sim is defined"
            )
    lowest = np.linalg.eigvalsh(seen.mass)[:, 0]
    if lowest.min() <= 0.0:
        at = np.array2string(q[np.argmin(lowest)], precision=4)
        raise ValueError(
            f"{what}: the mass matrix is not positive at q = {at} (eigenvalue {lowest.min():.3g}); "
            "a coordinate without inertia cannot be simulated"
        )
    return replace(seen, acceleration=mechanics.acceleration(q, v, region.u))


def _solved(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Amounts (k, r) of shared columns (N, d, k) that make up each of (N, d, r) best."""
    flat = left.reshape(-1, left.shape[2])
    return lstsq(flat, right.reshape(len(flat), -1), cond=1e-12, lapack_driver="gelsy")[0]


def fit_fields(seen: FieldSamples, basis: Basis) -> MechanicalModel:
    """The model, every field with the smallest number of functions that serves."""
    d, region = seen.region.d, seen.region
    ends = list_field_sizes(basis)
    phi, slopes = basis.values(region.q), basis.slopes(region.q)
    inertia = np.einsum("nij,nj->ni", seen.mass, seen.acceleration) + seen.turning
    pairs = d * (d + 1) // 2
    columns, wanted = seen.share(_inertial(phi, slopes, seen)), seen.share(inertia[..., None])
    mass = _smallest(
        lambda k: _matrices(_solved(columns[:, :, : k * pairs], wanted), d),
        lambda m: seen.error(_applied(phi, slopes, m, seen) - inertia),
        ends,
    )
    pulls, pull = seen.share(slopes[:, 1:].transpose(0, 2, 1)), seen.share(seen.slope[..., None])
    potential = _smallest(
        lambda k: np.append(0.0, _solved(pulls[:, :, : k - 1], pull)),
        lambda p: seen.error(np.einsum("nki,k->ni", slopes[:, : len(p)], p) - seen.slope),
        ends[2:],
    )
    reach = np.zeros((0, region.n_u, d))
    if region.n_u:
        along = seen.share(np.einsum("nk,ij->nikj", phi, np.eye(d)).reshape(len(phi), d, -1))
        given = seen.share(seen.input_map.transpose(0, 2, 1))
        reach = _smallest(
            lambda k: _solved(along[:, :, : k * d], given).reshape(k, d, -1).transpose(0, 2, 1),
            lambda b: seen.error(
                np.einsum("nci,nc->ni", np.tensordot(phi[:, : len(b)], b, 1) - seen.input_map, region.u)
            ),
            ends,
        )
    damping, dry, drag, width = _losses(seen, phi, ends)
    # the scale of all of them is free: inertia is counted in units of its own mean
    unit = float(np.trace(mass[0])) / d
    unit = unit if unit > 0.0 else float(np.mean(np.trace(seen.mass, axis1=1, axis2=2))) / d
    return MechanicalModel(
        basis, mass / unit, damping / unit, potential / unit, reach / unit, dry / unit, drag / unit, width,
        np.median(region.q, axis=0),
    )  # fmt: skip


def _smallest(
    fit: Callable[[int], np.ndarray], error: Callable[[np.ndarray], float], ends: list[int]
) -> np.ndarray:
    """The coefficients with the fewest functions that leave a tenth of the tolerance, or the best."""
    best, lowest = np.zeros(0), np.inf
    for end in ends:
        tried = fit(end)
        wrong = error(tried)
        if wrong < 0.9 * lowest:
            best, lowest = tried, wrong
        if wrong < 0.1 * PROJECTION_FIELDS.tolerance:
            break
    return best


def _matrices(amounts: np.ndarray, d: int) -> Float64[np.ndarray, "K d d"]:
    """Symmetric matrices, one a function, from the amounts of their parts."""
    pairs = make_symmetric_basis(d)
    return np.einsum("kp,pij->kij", amounts.reshape(-1, len(pairs)), pairs)


def _inertial(phi: np.ndarray, slopes: np.ndarray, seen: FieldSamples) -> Float64[np.ndarray, "N d K"]:
    """``M a + c`` of every function times every symmetric matrix, one column each."""
    v, pairs = seen.region.v, make_symmetric_basis(seen.region.d)
    pushed = np.einsum("pij,nj->npi", pairs, seen.acceleration)
    swung = np.einsum("pij,nj->npi", pairs, v)
    rate = np.einsum("nki,ni->nk", slopes, v)
    columns = np.einsum("nk,npi->nikp", phi, pushed) + np.einsum("nk,npi->nikp", rate, swung)
    columns -= 0.5 * np.einsum("nki,np->nikp", slopes, np.einsum("npi,ni->np", swung, v))
    return columns.reshape(*v.shape, -1)


def _applied(phi: np.ndarray, slopes: np.ndarray, mass: np.ndarray, seen: FieldSamples) -> np.ndarray:
    """``M a + c`` of a fitted mass."""
    k, v = len(mass), seen.region.v
    rate = np.einsum("nki,kab->niab", slopes[:, :k], mass)
    turning = np.einsum("niab,ni,nb->na", rate, v, v) - 0.5 * np.einsum("niab,na,nb->ni", rate, v, v)
    return np.einsum("nij,nj->ni", np.tensordot(phi[:, :k], mass, 1), seen.acceleration) + turning


def make_symmetric_basis(d: int) -> Float64[np.ndarray, "P d d"]:
    """The symmetric matrices with one pair of ones."""
    pairs = [(i, j) for i in range(d) for j in range(i, d)]
    out = np.zeros((len(pairs), d, d))
    for n, (i, j) in enumerate(pairs):
        out[n, i, j] = out[n, j, i] = 1.0
    return out


def build_friction_columns(v: Float64[np.ndarray, "N d"], width: np.ndarray | None, drag: bool) -> np.ndarray:
    """Columns (N, d, k) of dry friction of a width (d,), if any, and of drag: one for each coordinate."""
    parts = [] if width is None else [np.tanh(v / width)]
    parts += [np.abs(v) * v] if drag else []
    return np.concatenate([p[:, :, None] * np.eye(v.shape[1]) for p in parts] or [np.zeros((*v.shape, 0))], 2)


def _losses(seen: FieldSamples, phi: np.ndarray, ends: list[int]) -> tuple[np.ndarray, ...]:
    """Damping, dry friction, drag and the width of the dry friction; the smallest set that serves."""
    v, d, speed = seen.region.v, seen.region.d, np.maximum(seen.region.speed, 1e-12)
    pairs = make_symmetric_basis(d)
    viscous = seen.share(np.einsum("nk,pij,nj->nikp", phi, pairs, v).reshape(len(v), d, -1))
    lost = seen.share(seen.loss[..., None])
    options: list[tuple[np.ndarray | None, bool, np.ndarray]] = []
    for drag in (False, True):
        for width in (None, *PROJECTION_FIELDS.friction_widths):
            wide = None if width is None else width * speed
            options.append((wide, drag, seen.share(build_friction_columns(v, wide, drag))))
    best: tuple[np.ndarray, ...] = ()
    lowest = np.inf
    for end in ends:
        n = end * len(pairs)
        for wide, drag, rubbing in options:
            columns = np.concatenate([viscous[:, :, :n], rubbing], axis=2)
            x = _solved(columns, lost)
            wrong = float(np.max(np.sqrt(np.mean((columns @ x - lost) ** 2, axis=(0, 2)))))
            x = x[:, 0]
            if wrong < 0.8 * lowest:
                lowest = wrong
                dry = np.zeros(d) if wide is None else x[n : n + d]
                drags = x[-d:] if drag else np.zeros(d)
                best = (
                    _matrices(x[:n], d),
                    dry,
                    drags,
                    PROJECTION_FIELDS.default_friction_width * speed if wide is None else wide,
                )
            if lowest < 0.1 * PROJECTION_FIELDS.tolerance:
                return best
    return best
