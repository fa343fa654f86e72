"""A simulator that is a fitted run: its Lagrangian, and the motion it was fitted to.

A polynomial law is simple in coordinates ``x = g(q)`` of its own; in the latents ``q`` its terms have a far
higher degree. So it is diagnosed over ``x``, and any other law over the latents.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.identification.novelty import KnownRegion
from lagsplat.diagnose.simulators.projection import FieldFunctions, ProjectedModel, project_fields
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.monomials import ROOM
from lagsplat.stage2.lagrangian import Lagrangian

MIN_INSIDE = 0.5  # share of a region within the data of the fit, from which the rest is left out
BATCH_SIZE = 256  # points that the networks evaluate at once, which bounds their memory


@torch.no_grad()
def convert_to_law(lagrangian: Lagrangian, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N d"]:
    """The coordinates of the law at whitened latents."""
    found = lagrangian.coordinates
    return q if found is None else found.evaluate(torch.as_tensor(q))[0].numpy()


@torch.no_grad()
def convert_to_latents(lagrangian: Lagrangian, x: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N d"]:
    """The whitened latents at coordinates of the law; NaN where no latents have them."""
    found = lagrangian.coordinates
    return x if found is None else found.invert(torch.as_tensor(x)).numpy()


def project_run(lagrangian: Lagrangian, region: OperatingRegion, *, what: str) -> ProjectedModel:
    """The model of a fitted Lagrangian over a region of its coordinates, with time in seconds.

    A polynomial law is fitted exactly, where its polynomials are not clipped.

    Raises:
        ValueError: the region has other numbers of coordinates or inputs.
    """
    if (lagrangian.d, lagrangian.n_inputs) != (region.d, region.n_u):
        raise ValueError(
            f"{what}: the run has {lagrangian.d} latent(s) and {lagrangian.n_inputs} input(s), but the "
            f"recording {region.d} and {region.n_u}; encode the recording with this run's own autoencoder"
        )
    law, max_degree, known = lagrangian.in_own_coordinates(), None, None
    if law.energy is not None:
        degrees, ball = law.form.degrees, law.energy.ball.numpy()
        max_degree = max(degrees.potential, degrees.inputs, 2 * degrees.matrices)
        known = KnownRegion(ball[:-1], float(ball[-1]), ROOM)
        inside = known.measure_distance(region.q) < 1.0
        # a recording that is nearly all outside is beyond what the run was fitted to, and reported as such
        if inside.mean() > MIN_INSIDE:
            region = region.select(inside)
    projected = project_fields(make_run_fields(law, region), region, what=what, max_degree=max_degree)
    return replace(projected, known_region=known)


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
