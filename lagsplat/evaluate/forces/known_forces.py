"""Simulate true answers to known forces, and compare the energies of a learned law with the true ones.

One factor between learned and true energies may fit all motions, or each may need another.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, Int64

from lagsplat.chart.trajectory import TimeBase
from lagsplat.evaluate.protocol import STENCILS
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.equilibrium import VISITED, OperatingPoint, compute_static_stiffness
from lagsplat.stage2.decoder_mass import InducedMass
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.systems.pushable import Pushable

ALONG = 0.25  # directions whose answer is below this share of the largest one at the point are left out
MOVED = 0.1
"""Points whose answer is below this share of the largest one, as at a centre of rotation, are left out."""


REFERENCE = 0.3  # the energy scale comes from a poke at the level nearest to this one


@dataclass(frozen=True)
class KnownForces:
    """Forces at ``N`` points and directions (unit, right and down), each at ``L`` growing sizes [J/px] whose
    linear answers go ``levels`` of the visited range away, and their true answers.

    ``states`` (N, L, d) are the true equilibria, NaN where there is none; ``ways`` (N, L, P, 2) [px] are the
    displacements of all material points from their ``places`` (P, 2) at rest; ``distance`` (N, L) is that of
    the true state from rest, in visited ranges.
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
    return KnownForces(
        levels=tuple(config.levels),
        places=places,
        point=point,
        direction=directions[chosen],
        size=size,
        states=states,
        ways=ways,
        distance=distance(states - system.rest) / reach,
    )


FLOOR = 1e-9


def measure_energy_spans(
    held: OperatingPoint, system: Pushable, slope: Float64[np.ndarray, "n d"]
) -> dict[str, float] | None:
    """Ratio of the largest to the smallest eigenvalue of matrices at rest relative to the true ones.

    It is 1 where one factor makes all energies true; the result is None with one coordinate, where it always
    is. ``mass`` and ``stiffness`` are the law's, ``induced`` the mass that equally heavy Gaussians induce.
    ``slope`` are the derivatives of the true coordinates by the latents. Free motion identifies the ratio of
    stiffness and mass in each mode, slow driven motion that of stiffness and input: neither identifies the
    relative energy of two modes.
    """
    if held.law.d == 1:
        return None
    rest = held.rest[None]
    with torch.no_grad():
        mass = held.law.mass(rest)[0].numpy()
        induced = InducedMass(held.kinematics.geometry, scale=1.0, floor=FLOOR).matrix(rest)[0].numpy()
    elastic = compute_static_stiffness(held.law, rest, held.u[None])[0].numpy()
    true_mass, true_elastic = (slope.T @ matrix @ slope for matrix in _true(system))
    return {
        "mass": _span(mass, true_mass),
        "induced": _span(induced, true_mass),
        "stiffness": _span(elastic, true_elastic),
    }


def _true(system: Pushable) -> tuple[np.ndarray, np.ndarray]:
    elastic = system.stiffness(system.rest)
    return system.mass(system.rest), 0.5 * (elastic + elastic.T)


def _span(matrix: np.ndarray, reference: np.ndarray) -> float:
    half = np.linalg.inv(np.linalg.cholesky(reference))
    values = np.linalg.eigvalsh(half @ matrix @ half.T)
    return float(values[-1] / values[0])


@torch.no_grad()
def mechanical_energy(
    lagrangian: Lagrangian, q: Float64[np.ndarray, "N d"], v: Float64[np.ndarray, "N d"]
) -> Float64[np.ndarray, " N"]:
    """``v.M v / 2 + V`` at states and velocities [1/s], in the law's unit of energy."""
    states = torch.from_numpy(np.ascontiguousarray(q))
    w = torch.from_numpy(np.ascontiguousarray(v)) * float(lagrangian.time_unit_s)
    kinetic = 0.5 * torch.einsum("bi,bij,bj->b", w, lagrangian.mass(states), w)
    return (kinetic + lagrangian.potential(states)).numpy()


def energy_along_rollout(
    lagrangian: Lagrangian,
) -> Callable[[Float64[np.ndarray, "N d"], float], Float64[np.ndarray, " M"]]:
    """A function that gives the energy along evenly spaced states [s], by fourth-order differences.

    Two states at either end are left out, because their differences would need states beyond the series.
    Every model is measured this way, even one that knows its velocity.
    """

    def along(states: np.ndarray, dt_s: float) -> np.ndarray:
        inner = np.arange(2, len(states) - 2)
        speeds = TimeBase(dt_s).slope(states, inner, STENCILS["central"])
        return mechanical_energy(lagrangian, states[inner], speeds)

    return along
