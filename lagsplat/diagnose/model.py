"""A sim as the diagnosis sees it: mass, damping, potential, input map and friction, in one basis.

    M(q) a + c(q, v) + C(q) v + dry tanh(v / width) + drag |v| v + dV/dq = b(q)^T u

with ``c = M' v - d(v.M v / 2)/dq``, so that energy is lost by ``C`` and friction alone. Inertia is counted in
units of the reference inertia: only ratios of M, C, V and b move anything.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.basis import Basis


@dataclass(frozen=True)
class Model:
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
