"""What the diagnosis asks of a simulated mechanism, whoever delivers it.

    M(q) a = force(q, v, u),

with ``force`` everything but the inertial term. All functions take N states at once.
"""

from typing import Protocol

import numpy as np
from jaxtyping import Float64


class Mechanics(Protocol):
    """A mechanism with ``d`` coordinates and ``n_u`` inputs, at rest in ``rest`` (d,)."""

    @property
    def d(self) -> int:
        """Number of coordinates."""

    @property
    def n_u(self) -> int:
        """Number of inputs."""

    @property
    def rest(self) -> np.ndarray:
        """Equilibrium without inputs, (d,)."""

    def mass_at(self, q: np.ndarray) -> np.ndarray:
        """Inertia at ``q`` (N, d), as (N, d, d)."""

    def force(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Every generalised force but the inertial one, (N, d)."""

    def acceleration(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """``M(q)^-1 force(q, v, u)``, (N, d)."""

    def inverse_dynamics(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, u: np.ndarray) -> np.ndarray:
        """``M(q) a - force(q, v, u)``: the force that the mechanism lacks, (N, d)."""


def rest_inertia(mechanics: Mechanics) -> Float64[np.ndarray, " d"]:
    """Reference inertia of each coordinate: the diagonal of ``M`` at rest, by which forces are divided.

    The diagonal, so that a force on one coordinate stays a number of that coordinate alone where inertia
    couples them.
    """
    return np.diagonal(mechanics.mass_at(np.asarray(mechanics.rest, dtype=float)[None])[0]).copy()
