"""Known forces on known points of a simulated system, and its true answers."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.held import VISITED
from lagsplat.systems.pushable import Pushable

ALONG = 0.25
"""Of the largest answer at a point: directions that move it less, across the motion, are left out."""
MOVED = 0.1
"""Of the largest answer anywhere: points that move less are left out, as those at a centre of rotation."""


REFERENCE = 0.3
"""Level nearest to which the one poke is made that gives the energy scale."""


@dataclass(frozen=True)
class Pokes:
    """``N`` points and directions (unit, right and down), each at ``L`` growing forces [J/px], whose linear
    answers go ``levels`` of the visited range away.

    ``states`` (N, L, d) are the true equilibria, NaN where there is none; ``ways`` (N, L, P, 2) [px] of all
    material points from their ``places`` (P, 2) at rest; ``distance`` (N, L) of the true state from rest, in
    visited ranges.
    """

    levels: tuple[float, ...]
    places: Float64[np.ndarray, "P 2"]
    point: Int64[np.ndarray, " N"]
    direction: Float64[np.ndarray, "N 2"]
    size: Float64[np.ndarray, "N L"]
    states: Float64[np.ndarray, "N L d"]
    ways: Float64[np.ndarray, "N L P 2"]
    distance: Float64[np.ndarray, "N L"]

    @property
    def reference(self) -> int:
        """The level whose true answers lie nearest to `REFERENCE`."""
        known = [row[np.isfinite(row)] for row in self.distance.T]
        return int(np.argmin([abs(np.median(row) - REFERENCE) if len(row) else np.inf for row in known]))

    @property
    def forces(self) -> Float64[np.ndarray, "N L 2"]:
        """The forces [J/px]."""
        return self.size[:, :, None] * self.direction[:, None]


def poke(system: Pushable, visited: Float64[np.ndarray, "T d"], config: ForcesConfig) -> Pokes:
    """The true answers, forces being such that the state goes each of ``forces.levels`` away by its linear
    answer, in units of the range that ``visited``, the true training states, fill (Mahalanobis distance).
    """
    away = visited - system.rest
    metric = np.linalg.pinv(np.atleast_2d(np.cov(visited, rowvar=False)))

    def distance(x: np.ndarray) -> np.ndarray:
        return np.sqrt(np.einsum("...i,ij,...j->...", x, metric, x))

    reach = float(np.quantile(distance(away), VISITED))
    angle = 2 * np.pi * np.arange(config.directions) / config.directions
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    felt = np.einsum("pcd,nc->pnd", system.jacobian(system.rest), directions)
    ease = distance(np.linalg.solve(system.stiffness(system.rest), felt[..., None])[..., 0]) / reach
    kept = (ease > ALONG * ease.max(1, keepdims=True)) & (ease.max(1, keepdims=True) > MOVED * ease.max())
    point, chosen = np.nonzero(kept)
    size = np.array(config.levels) / ease[point, chosen][:, None]
    states = np.stack(
        [
            system.settled(int(p), s[:, None] * directions[e])
            for p, e, s in zip(point, chosen, size, strict=True)
        ]
    )
    places = system.pixels(system.rest[None])[0]
    shape = (*states.shape[:2], *places.shape)
    ways = system.pixels(states.reshape(-1, states.shape[2])).reshape(shape) - places
    return Pokes(
        levels=tuple(config.levels),
        places=places,
        point=point,
        direction=directions[chosen],
        size=size,
        states=states,
        ways=ways,
        distance=distance(states - system.rest) / reach,
    )
