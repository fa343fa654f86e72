"""Compare how matter moves with the state with the true motion of material points of a simulated system."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.forces.accuracy import are_alike, to_shape_error
from lagsplat.evaluate.truth import fit_polynomial
from lagsplat.forces.grasp import follow_places
from lagsplat.integer_lists import choose_evenly
from lagsplat.matter.field import MatterField
from lagsplat.systems.dynamics import differentiate
from lagsplat.systems.pushable import Pushable
from lagsplat.systems.truth import Truth

FRAMES = 400  # maximum number of frames, evenly spaced, at which places are compared
REACH_PX = 2.0  # within which a true material point is one of the field
MOVES = 0.3  # share of the 90th percentile of all ways from which a point has a direction


@dataclass(frozen=True)
class MaterialPaths:
    """Places of material points in frames: true ones, and those to which a field of matter takes them.

    Args:
        rest: true places at the state at which all latents are zero [px].
        true: in each frame.
        found: in each frame; NaN for points that belong to no body of the field.
        jacobian: true motion per whitened unit at that state [px].
        found_jacobian: that of the field.
    """

    rest: Float64[np.ndarray, "P n"]
    true: Float64[np.ndarray, "T P n"]
    found: Float64[np.ndarray, "T P n"]
    jacobian: Float64[np.ndarray, "P n d"]
    found_jacobian: Float64[np.ndarray, "P n d"]

    @property
    def known(self) -> Bool[np.ndarray, " P"]:
        """Points that belong to a body of the field."""
        return np.isfinite(self.found_jacobian).all((1, 2))

    def measure(self) -> dict[str, Any]:
        """Errors, ready for JSON.

        ``path`` is the rms distance of the places over the rms way of the true ones, over held-out frames and
        points. ``direction_deg`` is the median angle, over points and coordinates, between the motions per
        latent, ``direction_deg_p90`` its 90th percentile; ``shape`` the residual of the motions of all points
        after the best factor, the median over coordinates. ``known`` is the share of the points that belong
        to a body.
        """
        known = self.known
        if not known.any():
            return {
                "known": 0.0,
                "path": None,
                "direction_deg": None,
                "direction_deg_p90": None,
                "shape": None,
            }
        away = self.found[:, known] - self.true[:, known]
        way = self.true[:, known] - self.rest[known]
        found, true = (np.moveaxis(each[known], 2, 0) for each in (self.found_jacobian, self.jacobian))
        cosine, _ = are_alike(found[:, None], true[:, None])
        sizes = np.linalg.norm(true, axis=2)
        moves = sizes > MOVES * np.quantile(sizes, 0.9, axis=1, keepdims=True)
        angles = np.degrees(
            np.arccos(np.clip((found * true).sum(2) / np.linalg.norm(found, axis=2) / sizes, -1, 1))
        )
        return {
            "known": float(known.mean()),
            "path": float(np.sqrt(np.mean(away**2) / np.mean(way**2))),
            "direction_deg": float(np.median(angles[moves])),
            "direction_deg_p90": float(np.quantile(angles[moves], 0.9)),
            "shape": float(np.median(to_shape_error(cosine))),
        }


def follow_material_points(
    matter: MatterField, chart: Chart, system: Pushable, truth: Truth
) -> MaterialPaths:
    """Follow the material points of a system through held-out frames.

    The true state at the mean of the latents is read from a map that is fitted to training frames.
    """
    n, d = chart.n_train, chart.d
    to_states = fit_polynomial(chart.train.latents, truth.states[:n])
    mean = to_states(np.zeros((1, d)))[0]
    slope = differentiate(to_states, np.zeros(d)).T
    rest, zero = system.places(mean[None])[0], torch.zeros(d, dtype=torch.float64)
    held_out = np.arange(n, len(chart.latents))
    chosen = held_out[choose_evenly(len(held_out), FRAMES)]
    points, on_matter = follow_places(matter, zero, torch.from_numpy(rest), radius=REACH_PX)
    known = on_matter.numpy()[:, None]
    return MaterialPaths(
        rest=rest,
        true=system.places(truth.states[chosen]),
        found=np.where(known, points.carry(torch.from_numpy(chart.latents[chosen])).numpy(), np.nan),
        jacobian=system.jacobian(mean) @ slope,
        found_jacobian=np.where(known[..., None], points.jacobian(zero).numpy(), np.nan),
    )
