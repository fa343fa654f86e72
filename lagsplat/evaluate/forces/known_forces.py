"""Simulate the true answers of a system to known forces."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.operating_point import VISITED
from lagsplat.systems.pushable import Pushable

ALONG = 0.25  # directions whose answer is below this share of the largest one at the point are left out
MOVED = 0.1
"""Points whose answer is below this share of the largest one, as at a centre of rotation, are left out."""
REFERENCE = 0.3  # the energy scale comes from a poke at the level nearest to this one


@dataclass(frozen=True)
class KnownForces:
    """Forces at ``N`` points and directions (unit, right and down), each at ``L`` growing sizes [J/px] whose
    linear answers go ``levels`` of the visited range away, and their true answers.

    ``ways`` (N, L, P, n) [px] are the true displacements of all material points from their ``places`` (P, n)
    at rest, NaN where there is no equilibrium; ``distance`` (N, L) is that of the true state from rest, in
    visited ranges.
    """

    levels: tuple[float, ...]
    places: Float64[np.ndarray, "P n"]
    point: Int64[np.ndarray, " N"]
    direction: Float64[np.ndarray, "N n"]
    size: Float64[np.ndarray, "N L"]
    ways: Float64[np.ndarray, "N L P n"]
    distance: Float64[np.ndarray, "N L"]

    @property
    def reference(self) -> int:
        """The level whose true answers lie nearest to `REFERENCE`."""
        known = [row[np.isfinite(row)] for row in self.distance.T]
        return int(np.argmin([abs(np.median(row) - REFERENCE) if len(row) else np.inf for row in known]))

    @property
    def forces(self) -> Float64[np.ndarray, "N L n"]:
        """The forces [J/px]."""
        return self.size[:, :, None] * self.direction[:, None]


def simulate_known_forces(
    system: Pushable, visited: Float64[np.ndarray, "T d"], config: ForcesConfig
) -> KnownForces:
    """Compute the true answers to forces whose linear answers go each of ``forces.levels`` away.

    Levels are Mahalanobis distances in units of the range that ``visited``, the true training states, fill.
    """
    away = visited - system.rest
    metric = np.linalg.pinv(np.atleast_2d(np.cov(visited, rowvar=False)))

    def distance(x: np.ndarray) -> np.ndarray:
        return np.sqrt(np.einsum("...i,ij,...j->...", x, metric, x))

    reach = float(np.quantile(distance(away), VISITED))
    angle = 2 * np.pi * np.arange(config.directions) / config.directions
    slopes = system.jacobian(system.rest)
    directions = np.zeros((len(angle), slopes.shape[1]))  # parallel to the picture
    directions[:, :2] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    felt = np.einsum("pcd,nc->pnd", slopes, directions)
    ease = distance(np.linalg.solve(system.stiffness(system.rest), felt[..., None])[..., 0]) / reach
    kept = (ease > ALONG * ease.max(1, keepdims=True)) & (ease.max(1, keepdims=True) > MOVED * ease.max())
    point, chosen = np.nonzero(kept)
    size = np.array(config.levels) / ease[point, chosen][:, None]
    pokes = zip(point.tolist(), size[:, :, None] * directions[chosen][:, None], strict=True)
    states = np.stack([system.settled(p, forces) for p, forces in pokes])
    places = system.places(system.rest[None])[0]
    shape = (*states.shape[:2], *places.shape)
    ways = system.places(states.reshape(-1, states.shape[2])).reshape(shape) - places
    return KnownForces(
        levels=tuple(config.levels),
        places=places,
        point=point,
        direction=directions[chosen],
        size=size,
        ways=ways,
        distance=distance(states - system.rest) / reach,
    )
