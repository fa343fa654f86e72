"""The equations of motion of a mechanism, and its natural frequencies at rest.

A simulated mechanism obeys ``M(q) a = force(q, v, u)``, where ``force`` holds everything but the inertial
term. `MechanicalModel` writes it in one basis of functions:

    M(q) a + c(q, v) + C(q) v + dry tanh(v / width) + drag |v| v + dV/dq = b(q)^T u

with ``c = M' v - d(v.M v / 2)/dq``, so that only ``C`` and friction dissipate energy. Inertia is counted in
units of the reference inertia: the motion depends on ratios of M, C, V and b alone. All functions take N
states at once.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.linalg import eig

from lagsplat.diagnose.mechanics.basis import Basis

States = Float64[np.ndarray, "N d"]
Inputs = Float64[np.ndarray, "N n_u"]
Matrices = Float64[np.ndarray, "N d d"]
STIFFNESS_STEP = 1e-4  # of central differences of a force, as a share of the usual range of a coordinate


@dataclass(frozen=True)
class MechanicalModel:
    """Coefficients of the fields in a basis; each field uses as many of its functions as it has rows."""

    basis: Basis
    mass: Float64[np.ndarray, "Km d d"]
    damping: Float64[np.ndarray, "Kc d d"]
    potential: Float64[np.ndarray, " Kv"]
    input_map: Float64[np.ndarray, "Kb n_u d"]
    dry: Float64[np.ndarray, " d"]  # dry friction of each coordinate, a generalised force
    drag: Float64[np.ndarray, " d"]  # quadratic, a generalised force over the squared velocity
    width: Float64[np.ndarray, " d"]  # speed below which dry friction is linear [unit of the coordinate / s]
    rest: Float64[np.ndarray, " d"]  # equilibrium without inputs; without one, the middle of the motion

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.mass.shape[1]

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return self.input_map.shape[1]

    def trim_basis(self) -> "MechanicalModel":
        """The model with its basis cut to the functions that some field uses."""
        used = max(len(self.mass), len(self.damping), len(self.potential), len(self.input_map))
        return replace(self, basis=self.basis.first(used))

    def mass_at(self, q: States) -> Matrices:
        """The mass matrix ``M(q)``."""
        return np.tensordot(self.basis.values(q)[:, : len(self.mass)], self.mass, 1)

    def damping_at(self, q: States) -> Matrices:
        """The damping matrix ``C(q)``."""
        return np.tensordot(self.basis.values(q)[:, : len(self.damping)], self.damping, 1)

    def spring(self, q: States) -> States:
        """The conservative force ``-dV/dq``."""
        slopes = self.basis.slopes(q)[:, : len(self.potential)]
        return -np.einsum("nki,k->ni", slopes, self.potential)

    def drive(self, q: States, u: Inputs) -> States:
        """The actuated force ``b(q)^T u``."""
        field = np.tensordot(self.basis.values(q)[:, : len(self.input_map)], self.input_map, 1)
        return np.einsum("nci,nc->ni", field, u)

    def force(self, q: States, v: States, u: Inputs) -> States:
        """Everything but inertia in ``M a = force``."""
        slopes = np.einsum("nki,kab->niab", self.basis.slopes(q)[:, : len(self.mass)], self.mass)
        coriolis = np.einsum("niab,ni,nb->na", slopes, v, v)
        coriolis = coriolis - 0.5 * np.einsum("niab,na,nb->ni", slopes, v, v)
        friction = np.einsum("nij,nj->ni", self.damping_at(q), v)
        friction = friction + self.dry * np.tanh(v / self.width) + self.drag * np.abs(v) * v
        return self.spring(q) + self.drive(q, u) - coriolis - friction

    def acceleration(self, q: States, v: States, u: Inputs) -> States:
        """``M(q)^-1 force(q, v, u)``."""
        return np.linalg.solve(self.mass_at(q), self.force(q, v, u)[..., None])[..., 0]

    @cached_property
    def inertia(self) -> Float64[np.ndarray, "d d"]:
        """The mass matrix at rest."""
        return self.mass_at(self.rest[None])[0]

    @property
    def rest_inertia(self) -> Float64[np.ndarray, " d"]:
        """Reference inertia of each coordinate, by which forces are divided: the diagonal of `inertia`.

        Only the diagonal, so that a force on one coordinate remains a number of that coordinate where inertia
        couples it to others.
        """
        return np.diagonal(self.inertia)

    @cached_property
    def stiffness(self) -> Float64[np.ndarray, "d d"]:
        """Second derivative of the potential at rest, by central differences of its gradient."""
        step = STIFFNESS_STEP * self.basis.scale
        ends = self.rest + np.concatenate([np.diag(step), -np.diag(step)])
        forward, backward = np.split(-self.spring(ends), 2)
        slope = (forward - backward) / (2.0 * step[:, None])
        return 0.5 * (slope + slope.T)


def compute_rest_frequencies_hz(
    mechanics: MechanicalModel, scale: Float64[np.ndarray, " d"]
) -> Float64[np.ndarray, " modes"]:
    """Undamped natural frequencies [Hz] at rest, in rising order, of the modes with a restoring force.

    ``scale`` (d,) is how far each coordinate usually moves: stiffness is measured by central differences of
    the force over `STIFFNESS_STEP` of it, without inputs.
    """
    d = mechanics.d
    rest = np.asarray(mechanics.rest, dtype=float)
    step = STIFFNESS_STEP * np.diag(scale)
    zero = np.zeros((d, d))
    inputs = np.zeros((d, mechanics.n_u))
    rise = mechanics.force(rest + step, zero, inputs) - mechanics.force(rest - step, zero, inputs)
    stiffness = -(rise / (2.0 * STIFFNESS_STEP * scale[:, None])).T
    squares = eig(stiffness, mechanics.mass_at(rest[None])[0], right=False)
    # A stiffness that is not symmetric (a learned one) gives small imaginary parts, which are dropped.
    return np.sqrt(np.sort(squares.real[squares.real > 0.0])) / (2.0 * np.pi)
