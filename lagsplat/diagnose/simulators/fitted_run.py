"""A simulator that is a fitted run: its Lagrangian, and the motion it was fitted to.

A polynomial law is simple in coordinates ``x = g(q)`` of its own; in the latents ``q`` its terms have a far
higher degree. So it is diagnosed over ``x``, and any other law over the latents.

A law of one polynomial coordinate has mass ``J(x)^2 M_0`` and damping ``J(x)^2 C_0``: both are constant along
``s``, the integral of ``J``. It is diagnosed over ``s``, because what acts on the mechanism is simple there:
along ``x`` a friction that does not depend on the place would seem to.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicHermiteSpline

from lagsplat.chart.chart import Chart
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.identification.novelty import KnownRegion
from lagsplat.diagnose.simulators.projection import FieldFunctions, ProjectedModel, project_fields
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.monomials import ROOM
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.polynomials import PolynomialField

MIN_INSIDE = 0.5  # share of a region within the data of the fit, from which the rest is left out
BATCH_SIZE = 256  # points that the networks evaluate at once, which bounds their memory
PATH_POINTS = 2049  # at which the frame of a law is integrated: the error is far below that of any law
SLOPE_STEP = 1e-4  # of central differences [whitened unit]
LEAST_SLOPE = 0.1  # of the frame: a law that nearly folds there is diagnosed over ``x``


@dataclass(frozen=True)
class StraightCoordinate:
    """The coordinate ``s`` of a law of one coordinate ``x`` along which its frame is one; linear outside."""

    x: Float64[np.ndarray, " P"]
    s: Float64[np.ndarray, " P"]
    slope: Float64[np.ndarray, " P"]  # ds/dx

    @classmethod
    @torch.no_grad()
    def of_law(cls, law: Lagrangian) -> "StraightCoordinate | None":
        """Integrate the frame of a law; None without one, or where it nearly folds."""
        if law.d != 1 or law.energy is None:
            return None
        assert isinstance(law.mass_term, PolynomialField)
        center, radius = law.energy.ball.numpy()
        x = center + (1.0 + ROOM) * radius * np.linspace(-1.0, 1.0, PATH_POINTS)
        slope = law.mass_term.frame.evaluate(torch.as_tensor(x[:, None]))[0][:, 0, 0].numpy()
        if not slope.min() > LEAST_SLOPE:
            return None
        s = cumulative_simpson(slope, x=x, initial=0.0)
        return cls(x, s - s[PATH_POINTS // 2] + center, slope)

    def measure(self, x: np.ndarray) -> np.ndarray:
        """``s`` at ``x``."""
        return _interpolate(self.x, self.s, self.slope, x)

    def invert(self, s: np.ndarray) -> np.ndarray:
        """``x`` at ``s``."""
        return _interpolate(self.s, self.x, 1.0 / self.slope, s)

    def slope_at(self, x: np.ndarray) -> np.ndarray:
        """``ds/dx`` at ``x``."""
        return np.interp(x, self.x, self.slope)


def _interpolate(x: np.ndarray, y: np.ndarray, slope: np.ndarray, at: np.ndarray) -> np.ndarray:
    inside = np.clip(at, x[0], x[-1])
    beyond = np.where(at > x[-1], slope[-1], slope[0]) * (at - inside)
    return np.asarray(CubicHermiteSpline(x, y, slope)(inside) + beyond)


@torch.no_grad()
def convert_to_law(lagrangian: Lagrangian, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N d"]:
    """The coordinates at whitened latents over which a law is diagnosed."""
    if lagrangian.coordinates is None:
        return q
    x = lagrangian.coordinates.evaluate(torch.as_tensor(q))[0].numpy()
    straight = StraightCoordinate.of_law(lagrangian)
    return x if straight is None else straight.measure(x)


@torch.no_grad()
def convert_to_latents(lagrangian: Lagrangian, x: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N d"]:
    """The whitened latents at coordinates over which a law is diagnosed; NaN where no latents have them."""
    if lagrangian.coordinates is None:
        return x
    straight = StraightCoordinate.of_law(lagrangian)
    own = x if straight is None else straight.invert(x)
    return lagrangian.coordinates.invert(torch.as_tensor(own)).numpy()


def linearize_law_coordinates(
    lagrangian: Lagrangian, q: Float64[np.ndarray, " d"]
) -> tuple[Float64[np.ndarray, " d"], Float64[np.ndarray, "d d"]]:
    """`convert_to_law` at one state, and its derivative there, by central differences."""
    steps = SLOPE_STEP * np.eye(len(q))
    at, *moved = convert_to_law(lagrangian, np.concatenate([q[None], q + steps, q - steps]))
    ahead, behind = np.split(np.array(moved), 2)
    return at, (ahead - behind).T / (2.0 * SLOPE_STEP)


def project_run(lagrangian: Lagrangian, region: OperatingRegion, *, what: str) -> ProjectedModel:
    """The model of a fitted Lagrangian over a region of its coordinates, with time in seconds.

    A polynomial law of several coordinates is fitted exactly, where its polynomials are not clipped.

    Raises:
        ValueError: the region has other numbers of coordinates or inputs.
    """
    if (lagrangian.d, lagrangian.n_inputs) != (region.d, region.n_u):
        raise ValueError(
            f"{what}: the run has {lagrangian.d} latent(s) and {lagrangian.n_inputs} input(s), but the "
            f"recording {region.d} and {region.n_u}; encode the recording with this run's own autoencoder"
        )
    law, max_degree, known = lagrangian.in_own_coordinates(), None, None
    straight = StraightCoordinate.of_law(lagrangian)
    if law.energy is not None:
        degrees, ball = law.form.degrees, law.energy.ball.numpy()
        max_degree = max(degrees.potential, degrees.inputs, 2 * degrees.matrices)
        known = KnownRegion(ball[:-1], float(ball[-1]), ROOM)
        if straight is not None:
            low, high = straight.measure(ball[0] + ball[1] * np.array([-1.0, 1.0]))
            known = KnownRegion(np.array([0.5 * (low + high)]), 0.5 * (high - low), ROOM)
            max_degree = None  # its terms are no polynomials there
        inside = known.measure_distance(region.q) < 1.0
        # a recording that is nearly all outside is beyond what the run was fitted to, and reported as such
        if inside.mean() > MIN_INSIDE:
            region = region.select(inside)
    fields = make_run_fields(law, region)
    if straight is not None:
        fields = straighten_fields(fields, straight)
    projected = project_fields(fields, region, what=what, max_degree=max_degree)
    return replace(projected, known_region=known)


def straighten_fields(fields: FieldFunctions, straight: StraightCoordinate) -> FieldFunctions:
    """The fields of a law of one coordinate ``x``, over ``s``."""

    def own(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = straight.invert(s)
        return x, straight.slope_at(x)

    def mass(s: np.ndarray) -> np.ndarray:
        x, slope = own(s)
        return fields.mass(x) / slope[:, :, None] ** 2

    def potential_gradient(s: np.ndarray) -> np.ndarray:
        x, slope = own(s)
        return fields.potential_gradient(x) / slope

    def input_map(s: np.ndarray) -> np.ndarray:
        x, slope = own(s)
        return fields.input_map(x) / slope[:, :, None]

    def dissipation(s: np.ndarray, v: np.ndarray) -> np.ndarray:
        x, slope = own(s)
        return fields.dissipation(x, v / slope) / slope

    return FieldFunctions(mass, potential_gradient, input_map, dissipation)


def make_run_fields(lagrangian: Lagrangian, region: OperatingRegion) -> FieldFunctions:
    """Mass, forces and input map of a Lagrangian with time in seconds; energies keep the Lagrangian's unit.

    With ``t = time_unit_s tau`` the mass is multiplied by the square of the unit and the damping by the unit.
    The input map is measured with inputs as large as the region's; for an input that acts differently with
    either sign it is the mean over the signs that the region has.
    """
    unit = float(lagrangian.time_unit_s)
    size = np.sqrt(np.mean(region.u**2, axis=0)) + 1e-12
    signs = [[s for s in (1.0, -1.0) if (s * column > 0.0).any()] or [1.0] for column in region.u.T]
    with torch.no_grad():
        ready = lagrangian.prepare()

    def conservative_force(q: np.ndarray, u: np.ndarray) -> np.ndarray:
        return _evaluate(lambda q, u: lagrangian.conservative_force(q, u, ready), q, u)

    def potential_gradient(q: np.ndarray) -> np.ndarray:
        return -conservative_force(q, np.zeros((len(q), lagrangian.n_inputs)))

    def input_map(q: np.ndarray) -> np.ndarray:
        forces, unloaded = np.zeros((len(q), lagrangian.n_inputs, lagrangian.d)), potential_gradient(q)
        for c, signs_of_input in enumerate(signs):
            for sign in signs_of_input:
                u = np.zeros((len(q), lagrangian.n_inputs))
                u[:, c] = sign * size[c]
                difference = unloaded + conservative_force(q, u)
                forces[:, c] += difference / (sign * size[c]) / len(signs_of_input)
        return forces

    return FieldFunctions(
        mass=lambda q: unit**2 * _evaluate(lagrangian.mass, q),
        potential_gradient=potential_gradient,
        input_map=input_map,
        dissipation=lambda q, v: unit * np.einsum("nij,nj->ni", _evaluate(lagrangian.damping, q), v),
    )


@torch.no_grad()
def _evaluate(function: Callable[..., torch.Tensor], *points: np.ndarray) -> np.ndarray:
    """Values of a function of many points, batch by batch."""
    values = []
    for start in range(0, len(points[0]), BATCH_SIZE):
        values.append(function(*(torch.as_tensor(x[start : start + BATCH_SIZE]) for x in points)))
    return torch.cat(values).double().numpy()


def read_chart_trajectory(chart: Chart, *, held_out: bool) -> Trajectory:
    """The trajectory that a run was fitted to: its held-out part, or its training part.

    Raises:
        ValueError: that part has no frame.
    """
    part = chart.held_out if held_out else chart.train
    if not part.segments:
        raise ValueError("the run holds no frame out of its training; give another recording as real=")
    source = "held-out part" if held_out else "training part"
    motion = Trajectory(part.time_s, part.latents, part.inputs, source=source)
    return motion.pieces(part.segments)
