"""Compare the static answers of a law that was trained without forces with the true ones."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64

from lagsplat.evaluate.forces.known_forces import KnownForces
from lagsplat.forces.grasp import follow_places
from lagsplat.forces.loads import PointLoad
from lagsplat.forces.operating_point import NoScaleError, OperatingPoint, fit_energy_scale
from lagsplat.integer_lists import choose_evenly
from lagsplat.matter.field import MaterialPoints

OTHERS = 40  # maximum number of other pokes used to estimate the energy scale again
Read = Callable[[Float64[np.ndarray, "N d"]], Float64[np.ndarray, "N P n"]]
"""Maps whitened states to the places of the material points [px]."""
Errors = dict[str, Float64[np.ndarray, "N L"]]


@dataclass(frozen=True)
class GraspedPoints:
    """The matter of a field at each true material point, and which of these are on matter."""

    points: MaterialPoints
    usable: Bool[np.ndarray, " P"]

    def follow(self, states: Float64[np.ndarray, "*B d"]) -> Float64[np.ndarray, "*B P n"]:
        """Places of the points at states [px]; those off matter stay."""
        places = self.points.carry(torch.from_numpy(states.reshape(-1, states.shape[-1])))
        return places.numpy().reshape(*states.shape[:-1], *places.shape[1:])


def choose_grasps(
    point: OperatingPoint, places: Float64[np.ndarray, "P n"], *, radius: float
) -> GraspedPoints:
    """The matter under a brush of ``radius`` [px] on each material point."""
    points, usable = follow_places(point.matter, point.rest, torch.from_numpy(places), radius=radius)
    return GraspedPoints(points, usable.numpy())


def compare_answers(
    point: OperatingPoint, pokes: KnownForces, *, radius: float, read: Read
) -> dict[str, Any]:
    """Errors of the static answers, ready for JSON, with a brush of ``radius`` [px].

    Law and truth get the same force on the same material point; the energy scale comes from one poke, that
    of the easiest point and direction at the level `KnownForces.reference`. ``inside`` are medians (and 90th
    percentiles) over pokes whose true answer lies in the visited range, ``levels`` those at each level of
    force. ``direction_deg`` is the angle between the displacements of the pushed point, ``shape`` the
    relative residual of the displacements of all points after the best factor, and ``amplitude`` the distance
    of that factor from 1. ``pictured`` errors take the displacements from ``read``, which goes from latents
    through true coordinates to places in the image, the others from the field of matter.

    Raises:
        NoScaleError: no matter was found at the points, or the law answers the reference poke in the wrong
            direction.
    """
    grasps, inside = choose_grasps(point, pokes.places, radius=radius), pokes.distance <= 1.0
    scale, others = compare_scales(point, pokes, grasps)
    errors = compute_errors(point, pokes, grasps, scale, read)
    levels = []
    for i, level in enumerate(pokes.levels):
        row = summarize_errors(errors, np.arange(len(pokes.levels)) == i)
        levels.append({**row, "level": level, "distance": _median(pokes.distance[:, i])})
    places = []
    for p in np.unique(pokes.point):
        there = (pokes.point == p)[:, None] & inside
        medians = {name: _median(values[there]) for name, values in errors.items()}
        places.append({"place": pokes.places[p].tolist(), **medians})
    return {
        "points": int(grasps.usable.sum()),
        "missed": int((~grasps.usable).sum()),
        "scale": scale,
        "scale_of_others": np.quantile(others / scale, [0.1, 0.5, 0.9]).tolist(),
        "inside": summarize_errors(errors, inside),
        "levels": levels,
        "map": places,
        "tipped": int(np.isnan(pokes.distance).sum()),
        "pokes": int(inside.size),
    }


def compare_scales(
    point: OperatingPoint, pokes: KnownForces, grasps: GraspedPoints
) -> tuple[float, Float64[np.ndarray, " n"]]:
    """The energy scale by the reference poke, and those by the other pokes at its level.

    Raises:
        NoScaleError: nothing can be grasped, or the law answers in the wrong direction.
    """
    level, usable = pokes.reference, grasps.usable
    known = usable[pokes.point] & np.isfinite(pokes.distance[:, level])
    order = [int(i) for i in np.argsort(pokes.size[:, level]) if known[i]]
    observed = grasps.points[torch.from_numpy(np.flatnonzero(usable))]
    scales = []
    for i in (order[j] for j in choose_evenly(len(order), OTHERS)):
        push = push_points(pokes, grasps, np.array([i]), level, scale=1.0)
        try:
            scales.append(fit_energy_scale(point, push, observed, pokes.ways[i, level][usable]))
        except NoScaleError:
            if not scales:
                raise
    if not scales:
        raise NoScaleError("no point of the object can be taken hold of: no matter was found there")
    return scales[0], np.array(scales)


def push_points(
    pokes: KnownForces,
    grasps: GraspedPoints,
    rows: Int64[np.ndarray, " n"],
    level: int,
    *,
    scale: float,
) -> PointLoad:
    """Some of the forces of a level, on the grasped points, for an energy ``scale``."""
    points = grasps.points[torch.from_numpy(pokes.point[rows])]
    return PointLoad(points, scale * torch.from_numpy(pokes.forces[rows, level]))


def compute_errors(
    point: OperatingPoint, pokes: KnownForces, grasps: GraspedPoints, scale: float, read: Read
) -> Errors:
    """Every error of every poke for an energy ``scale``; NaN where there is no true answer or no grasp."""
    usable, rest = grasps.usable, point.rest.numpy()
    known = usable[pokes.point][:, None] & np.isfinite(pokes.distance)
    states = np.full((*known.shape, point.law.d), np.nan)
    for level in range(known.shape[1]):
        rows = np.flatnonzero(known[:, level])
        states[rows, level] = point.equilibria(push_points(pokes, grasps, rows, level, scale=scale)).numpy()
    carried = grasps.follow(states) - grasps.follow(rest)
    flat = states.reshape(-1, point.law.d)
    pictured = (read(flat) - read(rest[None])).reshape(pokes.ways.shape)
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
    answer: Float64[np.ndarray, "N L P n"], truth: Float64[np.ndarray, "N L P n"]
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
