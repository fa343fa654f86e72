"""Whether one factor turns the law's energies into the true ones, or every motion needs its own."""

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.forces.equilibrium import stiffness
from lagsplat.forces.held import Held
from lagsplat.stage2.induced import InducedMass
from lagsplat.systems.pushable import Pushable

FLOOR = 1e-9


def energy_spans(held: Held, system: Pushable, slope: Float64[np.ndarray, "n d"]) -> dict[str, float] | None:
    """Largest over smallest eigenvalue of matrices at rest relative to the true ones; None with one
    coordinate, where it says nothing.

    1 where one factor makes all energies true. ``mass`` and ``stiffness`` are the law's, ``induced`` the mass
    that equally heavy Gaussians induce. ``slope`` are the derivatives of the true coordinates by the latents.
    A free motion tells the ratio of stiffness and mass in each of its modes, and one that follows slow inputs
    the ratio of stiffness and input: neither tells the energy of one mode from that of another.
    """
    if held.law.d == 1:
        return None
    rest = held.rest[None]
    with torch.no_grad():
        mass = held.law.mass(rest)[0].numpy()
        induced = InducedMass(held.kinematics.geometry, scale=1.0, floor=FLOOR).matrix(rest)[0].numpy()
    elastic = stiffness(held.law, rest, held.u[None])[0].numpy()
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
