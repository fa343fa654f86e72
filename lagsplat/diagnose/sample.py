"""A sim that is given point by point, as mass, slope of the potential and so on, in the basis of a `Model`.

Every field is fitted alone by least squares over the region that was visited, with as few functions as leave
an error in the forces that does not matter.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.optimize import root

from lagsplat.diagnose.basis import Basis
from lagsplat.diagnose.identify import bases, degrees
from lagsplat.diagnose.model import Model
from lagsplat.diagnose.region import Region

TOLERANCE = 0.003
"""Error of the acceleration, in units of its root mean square, below which nothing is added."""
POOR = 0.02
"""Error above which a user is warned."""
EXACT = 1e-6
SLOW = 0.02
"""Width of the smooth dry friction, in units of the rms of the speed, unless another fits better."""
WIDTHS = (0.02, 0.05, 0.1, 0.2)
TOP = {1: 9, 2: 6, 3: 4}
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
class Sampled:
    """A model, and the error of its acceleration over the region, relative to the acceleration's own size."""

    model: Model
    error: float


@dataclass(frozen=True)
class Seen:
    """FieldFunctions at the points of a region, and the size of the forces there."""

    region: Region
    mass: np.ndarray
    turning: np.ndarray
    slope: np.ndarray
    input_map: np.ndarray
    loss: np.ndarray
    acceleration: np.ndarray

    @property
    def force(self) -> Float64[np.ndarray, " d"]:
        """Root mean square of ``M a`` and of all the forces that may balance one another."""
        terms = (
            np.einsum("nij,nj->ni", self.mass, self.acceleration), self.turning, self.slope, self.loss,
            np.einsum("nci,nc->ni", self.input_map, self.region.u),
        )  # fmt: skip
        return np.sqrt(np.mean(terms[0] ** 2, axis=0)) + 1e-9 * sum(np.abs(t).max() for t in terms) + 1e-300

    def error(self, wrong: np.ndarray) -> float:
        """Size of a wrong force (N, d), relative to the inertial one."""
        return float(np.max(np.sqrt(np.mean(wrong**2, axis=0)) / self.force))


def sample_mechanics(mechanics: FieldFunctions, region: Region, *, what: str) -> Sampled:
    """The model of a sim whose mass, potential, damping and input map are given; ``what`` names it to people.

    Raises:
        ValueError: a field is not finite in the region, or the mass matrix is not positive there.
    """
    seen = _look(mechanics, region, what)
    found = []
    for basis in reversed(bases(region.q, degree=TOP.get(region.d, 3))):
        model = _fitted(seen, basis)
        found.append(Sampled(model, acceleration_error(model, region, seen.acceleration)))
        if found[-1].error < EXACT:
            break
    return checked(min(found, key=merit), what=what)


def acceleration_error(model: Model, region: Region, acceleration: Float64[np.ndarray, "N d"]) -> float:
    """Root mean square of the error of the model's acceleration, in units of that of the acceleration itself.

    The worst coordinate counts. A model whose mass is not positive everywhere has an infinite error.
    """
    eigenvalues = np.linalg.eigvalsh(model.mass_at(region.q))
    if eigenvalues.min() < 1e-4 * eigenvalues.max():
        return float("inf")
    wrong = model.acceleration(region.q, region.v, region.u) - acceleration
    size = np.sqrt(np.mean(acceleration**2, axis=0))
    return float(np.max(np.sqrt(np.mean(wrong**2, axis=0)) / np.maximum(size, 1e-9 * size.max() + 1e-300)))


def merit(one: Sampled) -> tuple[int, float]:
    """To be minimised: exact ones first, then the smallest that is good, then the least bad."""
    if one.error < TOLERANCE:
        m = one.model
        return int(one.error > EXACT), m.mass.size + m.potential.size + m.damping.size + m.input_map.size
    return 2, one.error


def checked(one: Sampled, *, what: str) -> Sampled:
    """The same, cut to the functions it uses and with its point of rest; warns where it is poor."""
    if one.error > POOR:
        warnings.warn(
            f"{what}: its acceleration could be written in mass, damping, potential and inputs only to "
            f"within {100.0 * one.error:.1f} % over the region of the recording; what is missing (a "
            "contact, a limit, an input that does not act linearly) may be taken for an effect",
            stacklevel=3,
        )
    model = one.model
    size = max(len(model.mass), len(model.damping), len(model.potential), len(model.input_map))
    model = replace(model, basis=model.basis.first(size))
    return replace(one, model=replace(model, rest=rest_of(model)))


def rest_of(model: Model) -> Float64[np.ndarray, " d"]:
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


def _look(mechanics: FieldFunctions, region: Region, what: str) -> Seen:
    q, v = region.q, region.v
    seen = Seen(
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


def _fitted(seen: Seen, basis: Basis) -> Model:
    """Every field with the smallest number of functions that serves."""
    d, region = seen.region.d, seen.region
    ends = degrees(basis)
    phi, slopes = basis.values(region.q), basis.slopes(region.q)
    mass = _smallest(
        lambda k: np.linalg.lstsq(phi[:, :k], seen.mass.reshape(-1, d * d), rcond=1e-12)[0].reshape(-1, d, d),
        lambda m: seen.error(_inertial(phi, slopes, m, seen) - _given(seen)),
        ends,
    )
    potential = _smallest(
        lambda k: np.concatenate([[0.0], np.linalg.lstsq(
            slopes[:, 1:k].transpose(0, 2, 1).reshape(-1, k - 1), seen.slope.reshape(-1), rcond=1e-12)[0]]),
        lambda p: seen.error(np.einsum("nki,k->ni", slopes[:, : len(p)], p) - seen.slope),
        ends[2:],
    )  # fmt: skip
    reach = np.zeros((0, region.n_u, d))
    if region.n_u:
        flat = seen.input_map.reshape(len(phi), -1)
        reach = _smallest(
            lambda k: np.linalg.lstsq(phi[:, :k], flat, rcond=1e-12)[0].reshape(-1, region.n_u, d),
            lambda b: seen.error(np.einsum(
                "nci,nc->ni", np.tensordot(phi[:, : len(b)], b, 1) - seen.input_map, region.u)),
            ends,
        )  # fmt: skip
    damping, dry, drag, width = _losses(seen, phi, ends)
    # the scale of all of them is free: inertia is counted in units of its own mean
    unit = float(np.trace(mass[0])) / d
    unit = unit if unit > 0.0 else float(np.mean(np.trace(seen.mass, axis1=1, axis2=2))) / d
    return Model(
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
        if wrong < 0.1 * TOLERANCE:
            break
    return best


def _inertial(phi: np.ndarray, slopes: np.ndarray, mass: np.ndarray, seen: Seen) -> np.ndarray:
    """``M a + c`` of a fitted mass."""
    k, v = len(mass), seen.region.v
    rate = np.einsum("nki,kab->niab", slopes[:, :k], mass)
    turning = np.einsum("niab,ni,nb->na", rate, v, v) - 0.5 * np.einsum("niab,na,nb->ni", rate, v, v)
    return np.einsum("nij,nj->ni", np.tensordot(phi[:, :k], mass, 1), seen.acceleration) + turning


def _given(seen: Seen) -> np.ndarray:
    return np.einsum("nij,nj->ni", seen.mass, seen.acceleration) + seen.turning


def symmetric(d: int) -> Float64[np.ndarray, "P d d"]:
    """The symmetric matrices with one pair of ones."""
    pairs = [(i, j) for i in range(d) for j in range(i, d)]
    out = np.zeros((len(pairs), d, d))
    for n, (i, j) in enumerate(pairs):
        out[n, i, j] = out[n, j, i] = 1.0
    return out


def friction_columns(v: Float64[np.ndarray, "N d"], width: np.ndarray | None, drag: bool) -> np.ndarray:
    """Columns (N, d, k) of dry friction of a width (d,), if any, and of drag: one for each coordinate."""
    parts = [] if width is None else [np.tanh(v / width)]
    parts += [np.abs(v) * v] if drag else []
    return np.concatenate([p[:, :, None] * np.eye(v.shape[1]) for p in parts] or [np.zeros((*v.shape, 0))], 2)


def _losses(seen: Seen, phi: np.ndarray, ends: list[int]) -> tuple[np.ndarray, ...]:
    """Damping, dry friction, drag and the width of the dry friction; the smallest set that serves."""
    v, d, speed = seen.region.v, seen.region.d, np.maximum(seen.region.speed, 1e-12)
    pairs = symmetric(d)
    best: tuple[np.ndarray, ...] = ()
    lowest = np.inf
    options = [(None, False), *((w, False) for w in WIDTHS), (None, True), *((w, True) for w in WIDTHS)]
    for end in ends:
        viscous = np.einsum("nk,pij,nj->nikp", phi[:, :end], pairs, v).reshape(len(v), d, -1)
        for width, drag in options:
            wide = None if width is None else width * speed
            columns = np.concatenate([viscous, friction_columns(v, wide, drag)], axis=2)
            x = np.linalg.lstsq(columns.reshape(-1, columns.shape[2]), seen.loss.reshape(-1), rcond=1e-12)[0]
            wrong = seen.error(columns @ x - seen.loss)
            if wrong < 0.8 * lowest:
                lowest = wrong
                n = end * len(pairs)
                damping = np.einsum("kp,pij->kij", x[:n].reshape(end, -1), pairs)
                dry = np.zeros(d) if wide is None else x[n : n + d]
                best = (damping, dry, x[-d:] if drag else np.zeros(d), SLOW * speed if wide is None else wide)
            if lowest < 0.1 * TOLERANCE:
                return best
    return best
