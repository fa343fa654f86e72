"""How fast a mechanism swings about its rest, from its own equations.

A sim as the diagnosis sees it: mass, damping, potential, input map and friction, in one basis.

    M(q) a + c(q, v) + C(q) v + dry tanh(v / width) + drag |v| v + dV/dq = b(q)^T u

with ``c = M' v - d(v.M v / 2)/dq``, so that energy is lost by ``C`` and friction alone. Inertia is counted in
units of the reference inertia: only ratios of M, C, V and b move anything.

What the diagnosis asks of a simulated mechanism, whoever delivers it.

    M(q) a = force(q, v, u),

with ``force`` everything but the inertial term. All functions take N states at once.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from jaxtyping import Float64
from scipy.linalg import eig

from lagsplat.diagnose.mechanics.basis import Basis

STIFFNESS_STEP = 1e-4


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


def compute_rest_frequencies_hz(
    mechanics: Mechanics, scale: Float64[np.ndarray, " d"]
) -> Float64[np.ndarray, " modes"]:
    """Undamped natural frequencies at rest, rising; only those of modes that are pulled back, if any.

    ``scale`` (d,) is how far each coordinate usually moves: stiffness is the slope of the force across a
    ten-thousandth of it, without inputs.
    """
    d = mechanics.d
    rest = np.asarray(mechanics.rest, dtype=float)
    step = STIFFNESS_STEP * np.diag(scale)
    zero = np.zeros((d, d))
    inputs = np.zeros((d, mechanics.n_u))
    rise = mechanics.force(rest + step, zero, inputs) - mechanics.force(rest - step, zero, inputs)
    stiffness = -(rise / (2.0 * STIFFNESS_STEP * scale[:, None])).T
    squares = eig(stiffness, mechanics.mass_at(rest[None])[0], right=False)
    # A stiffness not symmetric (a learned one) may have a small imaginary part: its real part swings.
    return np.sqrt(np.sort(squares.real[squares.real > 0.0])) / (2.0 * np.pi)


def compute_rest_period_s(mechanics: Mechanics, scale: Float64[np.ndarray, " d"]) -> float:
    """Period of the slowest mode [s].

    Raises:
        ValueError: no mode is pulled back to rest.
    """
    frequencies = compute_rest_frequencies_hz(mechanics, scale)
    if not frequencies.size:
        raise ValueError(
            f"the sim is not pulled back to its rest {np.asarray(mechanics.rest).tolist()}, so that it has "
            "no natural period; give period_s"
        )
    return float(1.0 / frequencies[0])


@dataclass(frozen=True)
class MechanicalModel:
    """Coefficients of the fields; each uses as many of the basis' functions as it has rows."""

    basis: Basis
    mass: Float64[np.ndarray, "Km d d"]
    damping: Float64[np.ndarray, "Kc d d"]
    potential: Float64[np.ndarray, " Kv"]
    input_map: Float64[np.ndarray, "Kb n_u d"]
    dry: Float64[np.ndarray, " d"]
    drag: Float64[np.ndarray, " d"]
    width: Float64[np.ndarray, " d"]
    """Speed below which dry friction is linear [1/s times the coordinate's unit]."""
    rest: Float64[np.ndarray, " d"]
    """Where the unloaded mechanism comes to rest, or the middle of the motion if it never does."""

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.mass.shape[1]

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return self.input_map.shape[1]

    def mass_at(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N d d"]:
        """``M(q)``."""
        return np.tensordot(self.basis.first(len(self.mass)).values(q), self.mass, 1)

    def damping_at(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N d d"]:
        """``C(q)``."""
        return np.tensordot(self.basis.first(len(self.damping)).values(q), self.damping, 1)

    def spring(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N d"]:
        """The conservative force ``-dV/dq``."""
        slopes = self.basis.first(len(self.potential)).slopes(q)
        return -np.einsum("nki,k->ni", slopes, self.potential)

    def drive(
        self, q: Float64[np.ndarray, "N d"], u: Float64[np.ndarray, "N n_u"]
    ) -> Float64[np.ndarray, "N d"]:
        """The actuated force ``b(q)^T u``."""
        field = np.tensordot(self.basis.first(len(self.input_map)).values(q), self.input_map, 1)
        return np.einsum("nci,nc->ni", field, u)

    def force(
        self,
        q: Float64[np.ndarray, "N d"],
        v: Float64[np.ndarray, "N d"],
        u: Float64[np.ndarray, "N n_u"],
    ) -> Float64[np.ndarray, "N d"]:
        """Everything but inertia: ``M a = force``."""
        slopes = np.einsum("nki,kab->niab", self.basis.first(len(self.mass)).slopes(q), self.mass)
        turning = np.einsum("niab,ni,nb->na", slopes, v, v) - 0.5 * np.einsum("niab,na,nb->ni", slopes, v, v)
        friction = np.einsum("nij,nj->ni", self.damping_at(q), v)
        friction = friction + self.dry * np.tanh(v / self.width) + self.drag * np.abs(v) * v
        return self.spring(q) + self.drive(q, u) - turning - friction

    def acceleration(
        self,
        q: Float64[np.ndarray, "N d"],
        v: Float64[np.ndarray, "N d"],
        u: Float64[np.ndarray, "N n_u"],
    ) -> Float64[np.ndarray, "N d"]:
        """``M^-1 force``."""
        return np.linalg.solve(self.mass_at(q), self.force(q, v, u)[..., None])[..., 0]

    def inverse_dynamics(
        self,
        q: Float64[np.ndarray, "N d"],
        v: Float64[np.ndarray, "N d"],
        a: Float64[np.ndarray, "N d"],
        u: Float64[np.ndarray, "N n_u"],
    ) -> Float64[np.ndarray, "N d"]:
        """The generalised force that is missing: ``M a - force``."""
        return np.einsum("nij,nj->ni", self.mass_at(q), a) - self.force(q, v, u)

    @cached_property
    def inertia(self) -> Float64[np.ndarray, "d d"]:
        """``M(rest)``."""
        return self.mass_at(self.rest[None])[0]

    @cached_property
    def stiffness(self) -> Float64[np.ndarray, "d d"]:
        """Second derivative of the potential at rest, by central differences of its gradient."""
        step = 1e-4 * self.basis.scale
        ends = self.rest + np.concatenate([np.diag(step), -np.diag(step)])
        forward, backward = np.split(-self.spring(ends), 2)
        slope = (forward - backward) / (2.0 * step[:, None])
        return 0.5 * (slope + slope.T)


def compute_rest_inertia(mechanics: Mechanics) -> Float64[np.ndarray, " d"]:
    """Reference inertia of each coordinate: the diagonal of ``M`` at rest, by which forces are divided.

    The diagonal, so that a force on one coordinate stays a number of that coordinate alone where inertia
    couples them.
    """
    return np.diagonal(mechanics.mass_at(np.asarray(mechanics.rest, dtype=float)[None])[0]).copy()
