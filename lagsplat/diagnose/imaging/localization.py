"""Where in the image a gap lies: excess error of simulated images, and the point that a force acts on.

A point p of the body moves by ``J_p`` (d, 2) pixels for a step of the coordinates (row i: of coordinate i),
so a force f on it acts on the coordinates as ``J_p f``. A force by one of two laws is fitted for each point;
with too few coordinates points cannot be distinguished, and then nothing is localised.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import find_objects, label

from lagsplat.diagnose.core.config import IMAGES


@dataclass(frozen=True)
class ExcessError:
    """Where simulated images are worse than decoded ones."""

    map: np.ndarray  # (H, W) squared error beyond that of decoding
    parts: tuple[tuple[int, int, int, int, float], ...]
    """Regions of connected pixels as (left, top, right, bottom, share), the largest share first."""


@dataclass(frozen=True)
class ForceLocalization:
    """How well a force on each of P points explains the residual."""

    explained: np.ndarray  # (P,) share by the best law of each point
    law: tuple[str, ...]  # (P,) its name
    localisable: bool  # False where the kinematics cannot distinguish points
    point: int | None  # the best; None where nothing is localisable
    near: tuple[int, ...]  # all n that explain as much
    forces: np.ndarray  # (n, T, 2) on these, in units of the coordinates' forces per pixel

    @property
    def force(self) -> np.ndarray | None:
        """The force (T, 2) on the best point; None without one."""
        return None if self.point is None else self.forces[self.near.index(self.point)]


def compute_excess_error(
    real: Float64[np.ndarray, "T H W C"],
    sim: Float64[np.ndarray, "T H W C"],
    encoded: Float64[np.ndarray, "T H W C"],
) -> ExcessError:
    """Compute the error of simulated images beyond that of images decoded from the real frames' own latents.

    Raises:
        ValueError: images of different shapes.
    """
    if not real.shape == sim.shape == encoded.shape:
        raise ValueError(
            f"images of shapes {real.shape} (real), {sim.shape} (sim) and {encoded.shape} (encoded); "
            "render all three alike"
        )
    by_frame = np.mean((sim - real) ** 2 - (encoded - real) ** 2, axis=3)
    excess = np.mean(by_frame, axis=0)
    centre = np.median(excess)
    spread = 1.4826 * np.median(np.abs(excess - centre))
    least = max(IMAGES.pixel_z * spread, 1e-3 * np.max(np.abs(excess)) + 1e-300)
    numbers, _ = label(excess > centre + least)
    positive = np.maximum(excess, 0.0)
    pixels, sums = (np.bincount(numbers.ravel(), weights)[1:] for weights in (None, positive.ravel()))
    parts = [
        (columns.start, rows.start, columns.stop, rows.stop, float(share))
        for (rows, columns), count, share in zip(
            find_objects(numbers), pixels, sums / positive.sum(), strict=True
        )
        if count >= IMAGES.min_region_pixels
    ]
    parts.sort(key=lambda part: -part[4])
    return ExcessError(excess, tuple(parts[: IMAGES.max_regions]))


def localize_force(
    force: Float64[np.ndarray, "T d"],
    covariance: Float64[np.ndarray, "T d d"],
    jacobian: Float64[np.ndarray, "T P d 2"],
    velocity: Float64[np.ndarray, "T d"],
) -> ForceLocalization:
    """Find the material point on which a force explains the generalised forces ``force`` best.

    The laws are a constant force, and drag against the point's velocity and its square. A free force at every
    instant is not among them: with one or two coordinates it would explain anything at any point.

    Args:
        force: generalised forces.
        covariance: their covariance.
        jacobian: pixels by which each coordinate moves each of P points, at every instant.
        velocity: of the coordinates.

    Raises:
        ValueError: a force that is zero throughout.
    """
    weight = np.linalg.inv(covariance)
    total = np.einsum("ta,tab,tb->", force, weight, force)
    if not total > 0.0:
        raise ValueError("the residual force is zero throughout: there is nothing to place in the image")
    constant = np.broadcast_to(np.eye(2), (len(force), 2, 2))
    fits = []
    for p in range(jacobian.shape[1]):
        moved = np.einsum("tac,ta->tc", jacobian[:, p], velocity)
        drag = np.stack([moved, np.linalg.norm(moved, axis=1, keepdims=True) * moved], axis=2)
        tried = [
            (*_fit_law(force, weight, jacobian[:, p], columns), law)
            for law, columns in (("constant", constant), ("drag", drag))
        ]
        fits.append(min(tried, key=lambda fit: fit[0]))
    errors, forces, laws = zip(*fits, strict=True)
    explained = 1.0 - np.array(errors) / total
    moves = np.abs(jacobian).max(axis=(0, 2, 3)) > 0.0
    localisable = bool(explained.max() - explained[moves].min() >= IMAGES.min_contrast)
    if not localisable:
        return ForceLocalization(explained, laws, False, None, (), np.zeros((0, len(force), 2)))
    near = tuple(np.flatnonzero(explained >= explained.max() - IMAGES.equivalent_share).tolist())
    point = int(np.argmax(explained))
    return ForceLocalization(explained, laws, True, point, near, np.stack([forces[p] for p in near]))


def describe_image_region(
    excess: ExcessError | None, place: ForceLocalization | None, points: Float64[np.ndarray, "T P 2"] | None
) -> dict[str, Any]:
    """Describe both results as plain values.

    These are boxes [pixel] of excess error, and the mean position of the point a force acts on; ``points``
    (T, P, 2) [pixel] are the positions of the body's points.
    """
    region: dict[str, Any] = {"localisable": False if place is None else place.localisable}
    if excess is not None:
        region["excess"] = [{"box": list(part[:4]), "share": part[4]} for part in excess.parts]
    if place is not None and place.point is not None and points is not None:
        region["point"] = points[:, place.point].mean(axis=0).tolist()
        region["law"] = place.law[place.point]
        region["explained"] = float(place.explained[place.point])
        region["as_good"] = points[:, list(place.near)].mean(axis=0).tolist()
    return region


def _fit_law(
    force: np.ndarray, weight: np.ndarray, jacobian: np.ndarray, columns: np.ndarray
) -> tuple[float, Float64[np.ndarray, "T 2"]]:
    """Whitened squared error and fitted force of the best sum of ``columns`` (T, 2, k) at one point."""
    generalised = np.einsum("tac,tck->tak", jacobian, columns)
    size = np.sqrt(np.mean(generalised**2, axis=(0, 1)))
    size = np.where(size > 0.0, size, 1.0)
    generalised = generalised / size
    gram = np.einsum("tak,tab,tbl->kl", generalised, weight, generalised)
    moment = np.einsum("tak,tab,tb->k", generalised, weight, force)
    solution = np.linalg.lstsq(gram, moment, rcond=1e-12)[0]
    error = force - generalised @ solution
    return float(np.einsum("ta,tab,tb->", error, weight, error)), columns @ (solution / size)
