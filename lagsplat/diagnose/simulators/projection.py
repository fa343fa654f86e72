"""A sim that is given point by point, as mass, slope of the potential and so on, in the basis of a
`MechanicalModel`.

How each field is fitted is told in `lagsplat.diagnose.simulators.projection_fields`.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.optimize import root

from lagsplat.diagnose.core.config import PROJECTION, PROJECTION_FIELDS
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import build_candidate_bases
from lagsplat.diagnose.simulators.projection_fields import FieldSamples, fit_fields

EXACT_ERROR = 1e-6
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
