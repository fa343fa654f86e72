"""Compare the static answers of a law that was trained without forces with the true ones."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64

from lagsplat.evaluate.forces.known_forces import KnownForces
from lagsplat.evaluate.protocol import choose_evenly
from lagsplat.forces.equilibrium import NoScaleError, OperatingPoint, fit_energy_scale
from lagsplat.forces.grasp import NoMatterError, grasp_brush, grasp_nearest

OTHERS = 40  # maximum number of other pokes used to estimate the energy scale again
Read = Callable[[Float64[np.ndarray, "n d"]], Float64[np.ndarray, "n P 2"]]
"""Maps whitened states to the places of the material points [px] in the image."""
Errors = dict[str, Float64[np.ndarray, "N L"]]


@dataclass(frozen=True)
class GraspedPoints:
    """The Jacobian of the grasp of each material point, NaN where there is none, and which have one.

    ``field`` is how the points move [px per whitened unit]; zero where they are not grasped.
    """

    grips: Float64[np.ndarray, "P 2 d"]
    field: Float64[np.ndarray, "P 2 d"]
    usable: Bool[np.ndarray, " P"]


def choose_grasps(
    held: OperatingPoint, places: Float64[np.ndarray, "P 2"], *, radius: float | None
) -> GraspedPoints:
    """The grasp of a click on each material point, by a brush [px] or the nearest Gaussian."""
    grips = np.full((len(places), 2, held.law.d), np.nan)
    for i, (x, y) in enumerate(places.tolist()):
        try:
            nearest = grasp_nearest(held.kinematics, held.rest, (x, y)) if radius is None else None
            grip = nearest or grasp_brush(held.kinematics, held.rest, (x, y), radius=radius or 1.0)
        except NoMatterError:
            continue
        grips[i] = grip.jacobian.numpy()
    return GraspedPoints(grips, np.nan_to_num(grips), np.isfinite(grips).all((1, 2)))


def compare_answers(held: OperatingPoint, pokes: KnownForces, *, radius: float, read: Read) -> dict[str, Any]:
    """Errors of the static answers, ready for JSON, with a brush of ``radius`` [px].

    Law and truth get the same force on the same material point; the energy scale comes from one poke, that
    of the easiest point and direction at the level `KnownForces.reference`. ``inside`` are medians (and 90th
    percentiles) over pokes whose true answer lies in the visited range, ``levels`` those at each level of
    force; a ``nearest`` block grasps one Gaussian instead of a brush. ``direction_deg`` is the angle between
    the displacements of the pushed point, ``shape`` the relative residual of the displacements of all points
    after the best factor, and ``amplitude`` the distance of that factor from 1. ``pictured`` errors take
    the displacements from ``read``, which goes from latents through true coordinates to places in the image,
    the others from the decoder's matter.

    Raises:
        NoScaleError: with a brush, the law answers the reference poke in the wrong direction.
    """
    brushed, inside = choose_grasps(held, pokes.places, radius=radius), pokes.distance <= 1.0
    brush, errors = _score_grasps(held, pokes, brushed, read)
    levels = []
    for i, level in enumerate(pokes.levels):
        row = summarize_errors(errors, np.arange(len(pokes.levels)) == i)
        levels.append({**row, "level": level, "distance": _median(pokes.distance[:, i])})
    places = []
    for p in np.unique(pokes.point):
        there = (pokes.point == p)[:, None] & inside
        medians = {name: _median(values[there]) for name, values in errors.items()}
        places.append({"place": pokes.places[p].tolist(), **medians})
    nearest = replace(brushed, grips=choose_grasps(held, pokes.places, radius=None).grips)
    try:
        single, _ = _score_grasps(held, pokes, nearest, read)
    except NoScaleError as error:
        single = {"refused": str(error)}
    return {
        "points": int(brushed.usable.sum()),
        "missed": int((~brushed.usable).sum()),
        "brush": brush,
        "levels": levels,
        "map": places,
        "nearest": single,
        "tipped": int(np.isnan(pokes.distance).sum()),
        "pokes": int(inside.size),
    }


def _score_grasps(
    held: OperatingPoint, pokes: KnownForces, grasps: GraspedPoints, read: Read
) -> tuple[dict[str, Any], Errors]:
    scale, others = compare_scales(held, pokes, grasps)
    errors = compute_errors(held, pokes, grasps, scale, read)
    return {
        "scale": scale,
        "scale_of_others": np.quantile(others / scale, [0.1, 0.5, 0.9]).tolist(),
        "inside": summarize_errors(errors, pokes.distance <= 1.0),
    }, errors


def list_loads(pokes: KnownForces, grasps: GraspedPoints) -> Float64[np.ndarray, "N L d"]:
    """The pulled-back forces for an energy scale of one; NaN where nothing is grasped."""
    return pokes.forces @ grasps.grips[pokes.point]


def compare_scales(
    held: OperatingPoint, pokes: KnownForces, grasps: GraspedPoints
) -> tuple[float, Float64[np.ndarray, " n"]]:
    """The energy scale by the reference poke, and those by the other pokes at its level.

    Raises:
        NoScaleError: nothing can be grasped, or the law answers in the wrong direction.
    """
    level, usable = pokes.reference, grasps.usable
    loads = list_loads(pokes, grasps)[:, level]
    known = np.isfinite(loads).all(1) & np.isfinite(pokes.distance[:, level])
    order = [int(i) for i in np.argsort(pokes.size[:, level]) if known[i]]
    scales = []
    for i in (order[j] for j in choose_evenly(len(order), OTHERS)):
        try:
            scales.append(
                fit_energy_scale(held, loads[i], grasps.field[usable], pokes.ways[i, level][usable])
            )
        except NoScaleError:
            if not scales:
                raise
    if not scales:
        raise NoScaleError("no point of the object can be taken hold of: nothing is drawn there at rest")
    return scales[0], np.array(scales)


def compute_errors(
    held: OperatingPoint, pokes: KnownForces, grasps: GraspedPoints, scale: float, read: Read
) -> Errors:
    """Every error of every poke for an energy ``scale``; NaN where there is no true answer or no grasp."""
    loads, usable = scale * list_loads(pokes, grasps), grasps.usable
    known = np.isfinite(loads).all(2) & np.isfinite(pokes.distance)
    states = np.full((*known.shape, held.law.d), np.nan)
    states[known] = held.equilibria(torch.from_numpy(loads[known])).numpy()
    carried = np.einsum("pcd,nld->nlpc", grasps.field, states - held.rest.numpy())
    flat = states.reshape(-1, held.law.d)
    pictured = (read(flat) - read(held.rest.numpy()[None])).reshape(pokes.ways.shape)
    errors: Errors = {}
    pushed = pokes.point[:, None, None, None]
    for name, answer in (("", carried), ("pictured_", pictured)):
        cosine, factor = are_alike(answer[:, :, usable], pokes.ways[:, :, usable])
        errors[f"{name}shape"] = to_shape_error(cosine)
        errors[f"{name}amplitude"] = np.abs(factor - 1.0)
        there, _ = are_alike(*(np.take_along_axis(ways, pushed, axis=2) for ways in (answer, pokes.ways)))
        errors[f"{name}direction_deg"] = np.degrees(np.arccos(np.clip(there, -1.0, 1.0)))
    return errors


def are_alike(
    answer: Float64[np.ndarray, "N L P 2"], truth: Float64[np.ndarray, "N L P 2"]
) -> tuple[Float64[np.ndarray, "N L"], Float64[np.ndarray, "N L"]]:
    """Cosine between the displacements of all points, and the answer's projection on the truth (1 is
    exact).
    """
    product = np.einsum("nlpc,nlpc->nl", answer, truth)
    size, true = (np.sqrt(np.einsum("nlpc,nlpc->nl", ways, ways)) for ways in (answer, truth))
    with np.errstate(invalid="ignore", divide="ignore"):
        return product / (size * true), product / true**2


def to_shape_error(cosine: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
    """The relative residual of displacements after the best factor; an opposite answer counts as none."""
    return np.sqrt(1.0 - np.clip(cosine, 0.0, 1.0) ** 2)


def summarize_errors(errors: Errors, chosen: np.ndarray) -> dict[str, Any]:
    """Medians and 90th percentiles over the chosen pokes, and how many there are."""
    chosen = np.broadcast_to(chosen, next(iter(errors.values())).shape)
    summary: dict[str, Any] = {"n": int(np.isfinite(errors["shape"][chosen]).sum())}
    for name, values in errors.items():
        kept = values[chosen][np.isfinite(values[chosen])]
        summary[name] = _median(kept)
        summary[f"{name}_p90"] = float(np.quantile(kept, 0.9)) if len(kept) else None
    return summary


def _median(values: np.ndarray) -> float | None:
    kept = values[np.isfinite(values)]
    return float(np.median(kept)) if len(kept) else None
