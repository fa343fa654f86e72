"""Check what must hold of forces in the image whatever the energy scale is: signs, ratios and sums."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64
from scipy.optimize import minimize, root
from scipy.stats import spearmanr

from lagsplat.array_types import Latent
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.grasp import GraspPoint
from lagsplat.forces.loads import PointLoad
from lagsplat.forces.moving_parts import MovingParts, choose_background_points
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.integer_lists import choose_evenly
from lagsplat.matter.field import join_points
from lagsplat.stage2.equilibrium import compute_loaded_energy

POINTS = 60  # pixels of the object, evenly spaced in their list, at which it is pushed
BACKGROUND = 9  # points without motion at which the background is pushed
STATES = 32  # that are drawn to find them
ROUNDING = 1e-9  # share of the typical answer below which an answer is the rounding of the solver
STILL = 0.05  # share of the largest change of a colour below which a pixel is background
SMALL = 1e-5  # of the force, where answers are nearly linear
ANGLES = (0.7, 2.3)  # directions of the two forces that are added [rad]
BEND = 0.1  # cubic part of the coordinates in which an equilibrium is solved again


def force_invariants(point: OperatingPoint, config: ForcesConfig) -> dict[str, Any]:
    """The paper's checks on one run, ready for JSON.

    All forces have one size: the one that drives the state ``forces.response`` of the visited range away at
    the most compliant point. ``lever`` (one coordinate only): rank correlation of the answer to a downward
    force with the lever arm about the centre of rotation, and the share of points with its sign.
    ``background``: the largest answer to a force where the picture never changes, which is zero unless matter
    was found there, and the typical answer on the object over it. ``superposition``: relative error of sums
    of the pulled-back forces, of the answers, and of answers to forces ``SMALL`` as large. ``chart``: change
    of state [of the range] and of the image when solved in other coordinates. ``across``: share of a force
    across the motion that reaches the coordinates.

    Raises:
        ValueError: nothing moves in the image.

    Source: paper, "Applying forces".
    """
    scene, radius = point.find_moving_parts(), config.brush * point.width
    grips = _on(point, scene, radius)
    best = max(grips, key=lambda grip: float(torch.linalg.matrix_norm(grip.jacobian(point.rest), 2)))
    along = _easiest(point, best)
    size = point.find_force_size(best, along, share=config.response)
    return {
        "size": size,
        "lever": _lever(point, grips, size) if point.law.d == 1 else None,
        "background": _background(point, grips, size, radius),
        "superposition": _superposition(point, best, size),
        "chart": _chart(point, best, size * along),
        "across": _across(point, best) if point.law.d == 1 else None,
    }


def centre_of_rotation(grips: list[GraspPoint], q: Latent) -> Float64[np.ndarray, "2"]:
    """The point [px] about which the matter of one coordinate turns at a state, by least squares."""
    rows, values = [], []
    for grip in grips:  # J = w (-(y - cy), x - cx): linear in w, w cx and w cy
        (x, y), (right, down) = grip.at.numpy(), grip.jacobian(q)[:, 0].numpy()
        rows += [[-y, 0.0, 1.0], [x, -1.0, 0.0]]
        values += [right, down]
    turn, by_x, by_y = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0]
    return np.array([by_x, by_y]) / turn


def _on(point: OperatingPoint, scene: MovingParts, radius: float) -> list[GraspPoint]:
    places = np.argwhere(scene.object)
    if not len(places):
        raise ValueError("no point of the object can be taken hold of: nothing moves in the picture")
    chosen = places[choose_evenly(len(places), POINTS)]
    return [point.grasp((column + 0.5, row + 0.5), radius=radius) for row, column in chosen.tolist()]


def _easiest(point: OperatingPoint, grip: GraspPoint) -> Float64[np.ndarray, "2"]:
    return torch.linalg.svd(grip.jacobian(point.rest))[0][:, 0].numpy()


def _answers(
    point: OperatingPoint, grips: list[GraspPoint], forces: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "n d"]:
    push = PointLoad(join_points([grip.points for grip in grips]), torch.from_numpy(forces))
    return (point.equilibria(push) - point.rest).numpy()


def _lever(point: OperatingPoint, grips: list[GraspPoint], size: float) -> dict[str, float]:
    centre = centre_of_rotation(grips, point.rest)
    arms = np.array([float(grip.at[0]) for grip in grips]) - centre[0]
    answers = _answers(point, grips, np.tile([0.0, size], (len(grips), 1)))[:, 0]
    rank = float(spearmanr(arms, answers).statistic)
    agree = float(np.mean(np.sign(answers) == np.sign(arms) * np.sign(rank)))
    low, high = answers[arms.argmin()], answers[arms.argmax()]
    return {"rank": abs(rank), "sign": agree, "left": float(low), "right": float(high), "points": len(arms)}


def _background(
    point: OperatingPoint, grips: list[GraspPoint], size: float, radius: float
) -> dict[str, float | int | None]:
    points = choose_background_points(find_changing_pixels(point), BACKGROUND, margin=2 * radius)
    still = [point.grasp(at, radius=radius) for at in points]
    on = _answers(point, grips, np.stack([size * _easiest(point, grip) for grip in grips]))
    typical = float(np.median(np.linalg.norm(on, axis=1)))
    if not still:
        return {"points": 0, "largest": None, "typical": typical, "ratio": None}
    off = [_answers(point, still, np.tile(size * np.eye(2)[i], (len(still), 1))) for i in range(2)]
    largest = float(np.linalg.norm(np.concatenate(off), axis=1).max())
    largest = largest if largest > ROUNDING * typical else 0.0
    ratio = typical / largest if largest > 0.0 else None
    return {"points": len(still), "largest": largest, "typical": typical, "ratio": ratio}


def find_changing_pixels(point: OperatingPoint) -> Bool[np.ndarray, "H W"]:
    """Pixels whose colour changes with the visited states, as they are drawn; matter takes no part."""
    states = point.chart.train.latents
    drawn = point.render_images(torch.from_numpy(states[choose_evenly(len(states), STATES)]))
    change = drawn.std(0).max(2)
    return change > STILL * change.max()


def _superposition(point: OperatingPoint, grip: GraspPoint, size: float) -> dict[str, float]:
    parts = size * np.stack([[np.cos(angle), np.sin(angle)] for angle in ANGLES])
    three = np.concatenate([parts, parts.sum(0)[None]])
    loads = grip.pull_back(torch.from_numpy(three), point.rest).numpy()
    return {
        "force": _excess(loads),
        "answer": _excess(_answers(point, [grip] * 3, three)),
        "small_answer": _excess(_answers(point, [grip] * 3, SMALL * three)),
    }


def _excess(three: Float64[np.ndarray, "3 d"]) -> float:
    return float(np.linalg.norm(three[2] - three[0] - three[1]) / np.linalg.norm(three, axis=1).max())


def _chart(point: OperatingPoint, grip: GraspPoint, force: Float64[np.ndarray, "2"]) -> dict[str, float]:
    here = point.equilibria(PointLoad(grip.points, torch.from_numpy(force)[None]))[0]
    there = _settle_in_bent_chart(point, grip, force)
    pictures = point.render_images(torch.stack([here, there]))
    return {
        "state": float((here - there).norm()) / point.visited_radius,
        "picture": float(np.abs(pictures[0] - pictures[1]).max()),
    }


def _settle_in_bent_chart(
    point: OperatingPoint, grip: GraspPoint, force: Float64[np.ndarray, "2"]
) -> torch.Tensor:
    """The equilibrium under a force, solved in the coordinates ``x`` of ``q = rest + reach (x + x^3/10) A``.

    ``A`` is a random matrix of condition below three. Energy, elastic force and the matter's Jacobian are
    those of the new chart, ``J Psi`` with ``Psi = dq/dx``; the solver is another one (BFGS, then Powell's
    hybrid on the slope).

    Source: paper, Appendix "Invariance to the latent chart".
    """
    rng, d = np.random.default_rng(0), point.law.d
    turns = [np.linalg.qr(rng.standard_normal((d, d)))[0] for _ in range(2)]
    mixing = point.visited_radius * turns[0] @ np.diag(rng.uniform(0.6, 1.7, d)) @ turns[1]
    ready, rest = point.law.prepare(), point.rest.numpy()

    def back(x: np.ndarray) -> np.ndarray:
        return rest + (x + BEND * x**3) @ mixing

    def slope(x: np.ndarray) -> np.ndarray:
        stretch = (1.0 + 3.0 * BEND * x**2)[:, None] * mixing  # row i: dq / dx_i
        with torch.no_grad():
            q = torch.from_numpy(back(x))
            elastic = point.law.conservative_force(q[None], point.u[None], ready)
        return -(stretch @ elastic[0].numpy() + (grip.jacobian(q).numpy() @ stretch.T).T @ force)

    def value(x: np.ndarray) -> float:
        q = torch.from_numpy(back(x))
        with torch.no_grad():
            return float(
                compute_loaded_energy(point.law, q[None], point.u[None])[0]
                - torch.from_numpy(force) @ grip.place(q)
            )

    near = minimize(value, np.zeros(d), jac=slope, method="BFGS").x
    return torch.from_numpy(back(root(slope, near, tol=1e-13).x))


def _across(point: OperatingPoint, grip: GraspPoint) -> float:
    along = _easiest(point, grip)
    across = torch.tensor([-along[1], along[0]])
    felt = grip.pull_back(across, point.rest).norm()
    return float(felt / torch.linalg.matrix_norm(grip.jacobian(point.rest), 2))
