"""All measurements of forces in the image on one run: static answers, answers in time, forces in space."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.evaluate.forces import accuracy
from lagsplat.evaluate.forces.invariants import force_invariants
from lagsplat.evaluate.forces.known_forces import KnownForces, simulate_known_forces
from lagsplat.evaluate.truth import fit_polynomial
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.grasp import GraspPoint
from lagsplat.forces.loaded_lagrangian import rollout_under_force
from lagsplat.forces.loads import PointLoad
from lagsplat.forces.operating_point import NoScaleError, OperatingPoint
from lagsplat.forces.ray import RayHit, cast_ray, find_matter_depth, place_on_ray
from lagsplat.integer_lists import choose_evenly
from lagsplat.stage2.equilibrium import compute_static_stiffness
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.dynamics import differentiate
from lagsplat.systems.pushable import Pushable, make_pushable
from lagsplat.systems.truth import Truth

TRIALS = 12  # points whose answer in time is computed: each takes an integration of the truth
FLOOR = 1e-9
AHEAD, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
"""Along the video camera's line of sight, and down in its image."""
FELT = 1e-3  # smallest remainder of a unit vector across the motion for which a direction across is defined


def measure_forces(
    point: OperatingPoint,
    config: ForcesConfig,
    *,
    truth: Truth | None,
    driven: SimulationConfig | None,
    released: ReleaseConfig | None,
) -> dict[str, Any]:
    """The invariants of forces in the picture and, for a simulated system with its ``truth``, the errors
    against true answers, in the picture or in space.

    Where no energy scale makes the law answer the reference poke, the reason replaces these errors.

    ``driven`` and ``released`` say how it was simulated; give the one that applies.

    Raises:
        ValueError: nothing moves in the image.
    """
    in_space = point.matter.space == 3
    invariants = None if in_space else force_invariants(point, config)
    result: dict[str, Any] = {"d": point.law.d, "invariants": invariants, "truth": None}
    if truth is not None:
        system = make_pushable(
            driven, released, pressure=point.u.numpy(), points=config.points, in_space=in_space
        )
        try:
            result["truth"] = compare_forces_with_truth(point, system, truth, config)
        except NoScaleError as error:
            result["truth"] = {"refused": str(error)}
    return result


def compare_forces_with_truth(
    point: OperatingPoint, system: Pushable, truth: Truth, config: ForcesConfig
) -> dict[str, Any]:
    """Static answers, answers in time and first motions, against those of the true equations.

    True coordinates are read from latents by a map that is fitted to the training frames.
    """
    smooth, rest = point.chart.train.smoothed(point.chart.smoothing_frames).latents, point.rest.numpy()
    to_states = fit_polynomial(smooth, truth.states[: len(smooth)])
    slope = differentiate(to_states, rest).T
    radius = config.brush * point.width
    pokes = simulate_known_forces(system, truth.states[: point.chart.n_train], config)
    grasps = accuracy.choose_grasps(point, pokes.places, radius=radius)
    answers = accuracy.compare_answers(
        point, pokes, radius=radius, read=lambda q: system.places(to_states(q))
    )
    scale, length_s = answers["scale"], config.periods / float(truth.natural_frequencies_hz[0])
    return answers | {
        "in_time": respond_in_time(point, system, pokes, grasps, scale=scale, length_s=length_s),
        "energy_spans": measure_energy_spans(point, system, slope),
        "at_once": respond_at_once(point, system, pokes, grasps) if point.law.d > 1 else None,
    }


def easiest_direction(pokes: KnownForces, grasps: accuracy.GraspedPoints, level: int) -> list[int]:
    """The poke of least force at every point that can be grasped and has a true answer."""
    usable = np.isfinite(pokes.distance[:, level]) & grasps.usable[pokes.point]
    at_points = [np.flatnonzero(usable & (pokes.point == p)) for p in np.unique(pokes.point[usable])]
    return [int(candidates[pokes.size[candidates, level].argmin()]) for candidates in at_points]


def respond_in_time(
    point: OperatingPoint,
    system: Pushable,
    pokes: KnownForces,
    grasps: accuracy.GraspedPoints,
    *,
    scale: float,
    length_s: float,
) -> dict[str, Any]:
    """The answer to a force switched on at rest and kept on for ``length_s``, ready for JSON.

    ``error`` is the rms difference of the displacements of all points over the rms of the true ones,
    ``shape`` the same after the best factor; medians and 90th percentiles over at most `TRIALS` points.
    ``scale`` is the energy scale.
    """
    level, dt_s = pokes.reference, point.chart.dt_s
    easiest = easiest_direction(pokes, grasps, level)
    chosen = [easiest[i] for i in choose_evenly(len(easiest), TRIALS)]
    time_s = dt_s * np.arange(max(3, round(length_s / dt_s) + 1))
    moved = [system.moved(pokes.point[i], pokes.forces[i, level], time_s=time_s) for i in chosen]
    true = np.stack([system.places(states) - pokes.places for states in moved])
    push = accuracy.push_points(pokes, grasps, np.array(chosen), level, scale=scale)
    rows, steps = len(chosen), len(time_s)
    q, _ = rollout_under_force(
        point.law,
        point.rest.expand(rows, -1),
        torch.zeros(rows, point.law.d, dtype=torch.float64),
        point.u.expand(rows, steps, -1),
        [push] * (steps - 1),
        dt_s=dt_s,
    )
    ways = (grasps.follow(q.numpy()) - grasps.follow(point.rest.numpy()))[:, :, grasps.usable]
    true = true[:, :, grasps.usable]
    size = np.sqrt(np.mean(true**2, axis=(1, 2, 3)))
    error = np.sqrt(np.mean((ways - true) ** 2, axis=(1, 2, 3))) / size
    cosine, _ = accuracy.are_alike(
        ways.reshape(rows, 1, -1, true.shape[-1]), true.reshape(rows, 1, -1, true.shape[-1])
    )
    result = {"n": rows, "length_s": float(time_s[-1])}
    for name, values in (("error", error), ("shape", accuracy.to_shape_error(cosine[:, 0]))):
        result |= {name: float(np.median(values)), f"{name}_p90": float(np.quantile(values, 0.9))}
    return result


def respond_at_once(
    point: OperatingPoint, system: Pushable, pokes: KnownForces, grasps: accuracy.GraspedPoints
) -> dict[str, float]:
    """Shape error of the first motion, ``M^-1 J^T f``, with three masses; medians over the points.

    ``learned`` is the law's own mass, ``uniform`` the one that equally heavy material points induce, ``true``
    the one that the true masses of the bodies induce, each spread evenly over its body's material points.
    With one coordinate the mass is a factor and the three agree.

    Source: paper eq. (latent-metric), "we take the density to be uniform".
    """
    level, usable = pokes.reference, grasps.usable
    field = grasps.points.jacobian(point.rest).numpy()
    chosen = easiest_direction(pokes, grasps, level)
    learned, induced = _masses_at_rest(point)
    by_share = np.einsum("p,pca,pcb->ab", system.share * usable, field, field)
    true_mass = by_share + FLOOR * np.trace(by_share) * np.eye(point.law.d)
    jacobian = system.jacobian(system.rest)
    felt = np.stack([pokes.forces[i, level] @ jacobian[pokes.point[i]] for i in chosen])
    true = np.einsum("pcd,nd->npc", jacobian, np.linalg.solve(system.mass(system.rest), felt.T).T)
    push = accuracy.push_points(pokes, grasps, np.array(chosen), level, scale=1.0)
    loads = push.generalise(point.rest.expand(len(chosen), -1)).numpy()
    medians = {}
    for name, mass in (("learned", learned), ("uniform", induced), ("true", true_mass)):
        ways = np.einsum("pcd,nd->npc", field, np.linalg.solve(mass, loads.T).T)
        cosine, _ = accuracy.are_alike(ways[:, None][:, :, usable], true[:, None][:, :, usable])
        medians[name] = float(np.median(accuracy.to_shape_error(cosine)))
    return medians


def measure_energy_spans(
    point: OperatingPoint, system: Pushable, slope: Float64[np.ndarray, "n d"]
) -> dict[str, float] | None:
    """Ratio of the largest to the smallest eigenvalue of matrices at rest relative to the true ones.

    It is 1 where one factor makes all energies true; the result is None with one coordinate, where it always
    is. ``mass`` and ``stiffness`` are the law's, ``induced`` the mass that equally heavy material points
    induce.
    ``slope`` are the derivatives of the true coordinates by the latents. Free motion identifies the ratio of
    stiffness and mass in each mode, slow driven motion that of stiffness and input: neither identifies the
    relative energy of two modes.
    """
    if point.law.d == 1:
        return None
    learned, induced = _masses_at_rest(point)
    elastic = compute_static_stiffness(point.law, point.rest[None], point.u[None])[0].numpy()
    true_elastic = system.stiffness(system.rest)
    true_mass = slope.T @ system.mass(system.rest) @ slope
    return {
        "mass": _span(learned, true_mass),
        "induced": _span(induced, true_mass),
        "stiffness": _span(elastic, slope.T @ (0.5 * (true_elastic + true_elastic.T)) @ slope),
    }


@torch.no_grad()
def _masses_at_rest(point: OperatingPoint) -> tuple[np.ndarray, np.ndarray]:
    """The learned mass, and the one that equally heavy material points induce."""
    slopes = point.matter.jacobian(point.rest).numpy()
    induced = np.einsum("pca,pcb->ab", slopes, slopes)
    induced += FLOOR * np.trace(induced) * np.eye(point.law.d)
    return point.law.mass(point.rest[None])[0].numpy(), induced


def _span(matrix: np.ndarray, reference: np.ndarray) -> float:
    half = np.linalg.inv(np.linalg.cholesky(reference))
    values = np.linalg.eigvalsh(half @ matrix @ half.T)
    return float(values[-1] / values[0])


@dataclass(frozen=True)
class SpacePush:
    """A click, its grasp, and the answers to forces of one ``size`` [energy per px at the pivot] on it.

    ``directions`` are unit vectors of space: x to the right, y down, z ahead of the video's camera.
    ``states`` are the equilibria under no force, the rest, under the one across the motion and the one down.
    """

    pixel: tuple[float, float]
    hit: RayHit
    grip: GraspPoint
    size: float
    directions: Float64[np.ndarray, "2 3"]
    states: Float64[np.ndarray, "3 d"]

    def numbers(self) -> dict[str, Any]:
        """The numbers of the figure, ready for JSON.

        ``felt_across`` is ``|J^T f|`` over ``|J| |f|``, ``pulled_across`` ``|J^T f|`` of the force itself.
        """
        across, rest = (torch.from_numpy(each[0]) for each in (self.directions, self.states))
        pulled = float(self.grip.pull_back(across, rest).norm())
        shifts = np.linalg.norm(self.states[1:] - self.states[0], axis=1)
        return {
            "pixel": self.pixel,
            "gaussian": self.hit.gaussian,
            "depth": self.hit.depth,
            "cover": self.hit.cover,
            "size": self.size,
            "across": self.directions[0].tolist(),
            "felt_across": pulled / float(torch.linalg.matrix_norm(self.grip.jacobian(rest), 2)),
            "pulled_across": self.size * pulled,
            "shift_across": float(shifts[0]),
            "shift_down": float(shifts[1]),
            "state_down": self.states[2].tolist(),
        }


def push_in_space(point: OperatingPoint, config: ForcesConfig) -> SpacePush:
    """Click where the video has the largest vertical motion, and push there across the motion and down.

    Both forces have the size that drives the state ``forces.response`` of the visited range downwards.

    Raises:
        ValueError: nothing moves up or down, or the state moves the matter in every direction of space.

    Source: paper, "Forces in three dimensions".
    """
    scene = point.find_moving_parts()
    lever = np.where(scene.inner, np.linalg.norm(scene.jacobian[:, :, 1], axis=2), 0.0)
    if not lever.any():
        raise ValueError("nothing moves up or down in the picture: there is nothing to push; check stage 1")
    row, column = np.unravel_index(int(lever.argmax()), lever.shape)
    pixel = (float(column) + 0.5, float(row) + 0.5)
    view = point.autoencoder.filmed_view(point.autoencoder.gaussians.center)
    hit = cast_ray(point.autoencoder, point.chart, point.rest, view, pixel)
    depth = find_matter_depth(point.matter, point.rest, view, pixel, hit)
    grip = point.grasp(place_on_ray(view, pixel, depth), radius=config.brush * point.width)
    directions = np.stack([push_across(grip.jacobian(point.rest)), DOWN])
    size = point.find_force_size(grip, DOWN, share=config.response)
    forces = size * np.concatenate([np.zeros((1, 3)), directions])
    states = point.equilibria(PointLoad(grip.points, torch.from_numpy(forces)))
    return SpacePush(pixel, hit, grip, size, directions, states.numpy())


def push_across(jacobian: Float[Tensor, "3 d"]) -> Float64[np.ndarray, "3"]:
    """The direction in which the matter never moves, closest to the video's line of sight or, failing that,
    to its horizontal.

    Raises:
        ValueError: the columns of the Jacobian span space.
    """
    ways = np.linalg.qr(jacobian.numpy())[0] if float(jacobian.abs().max()) > 0 else np.zeros((3, 1))
    for start in (AHEAD, np.array([1.0, 0.0, 0.0]), DOWN):
        left = start
        for _ in range(3):  # one pass is exact but for rounding, which the next ones remove
            left = left - ways @ (ways.T @ left)
        if (size := float(np.linalg.norm(left))) > FELT:
            return left / size
    raise ValueError(
        f"the {jacobian.shape[1]} coordinates move this matter in every direction of space: none is across"
    )
