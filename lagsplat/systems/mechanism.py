"""Planar mechanisms without inputs: hanging links, rocking bodies, and their free motion.

Positions are in metres, x to the right and y down, in the plane of motion. The pose of a body is the place of
its origin and its angle, clockwise as seen.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.systems import dynamics
from lagsplat.systems.config import ReleaseConfig
from lagsplat.systems.dynamics import Matrix, Series, Vector, VibrationModes

Poses = Float64[np.ndarray, "T n_bodies 3"]  # x [m], y [m] and angle [rad] of every body
Push = Callable[[float, Vector], Vector]  # generalised force at a time [s] and state


@dataclass(frozen=True)
class Linkage:
    """A hanging chain, from the pivot on; the coordinates are the links' angles from the vertical [rad]."""

    length: Float64[np.ndarray, " d"]  # to the next hinge [m]
    masses: Float64[np.ndarray, " d"]  # [kg]
    center: Float64[np.ndarray, " d"]  # of mass, from the link's hinge [m]
    inertia: Float64[np.ndarray, " d"]  # about the centre of mass [kg m^2]
    friction: Float64[np.ndarray, " d"]  # of the hinge, on the angle relative to the link before [N m s/rad]
    spring: Float64[np.ndarray, " d"]  # likewise [N m/rad]
    gravity: float

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the link angles, with their unit."""
        return tuple(f"angle {i + 1} [rad]" for i in range(len(self.length)))

    @property
    def _arms(self) -> Float64[np.ndarray, "d d"]:
        """Row k: derivative of the centre of mass of link k by the angle of link i, in line [m]."""
        d = len(self.length)
        return np.where(np.tri(d, k=-1, dtype=bool), self.length, np.diag(self.center))

    @property
    def _moments(self) -> Matrix:
        """``sum_k m_k a_ki a_kj``, and the inertias: the mass matrix of links in line."""
        return self._arms.T @ (self.masses[:, None] * self._arms) + np.diag(self.inertia)

    def _joints(self, values: Float64[np.ndarray, " d"]) -> Matrix:
        """Turn a diagonal form of the relative angles into a matrix on the angles."""
        relative = np.eye(len(values)) - np.eye(len(values), k=-1)
        return relative.T @ (values[:, None] * relative)

    def mass(self, q: Vector) -> Matrix:
        """Mass matrix [kg m^2]."""
        return self._moments * np.cos(q[:, None] - q[None, :])

    def damping(self) -> Matrix:
        """Constant viscous damping matrix [N m s/rad]."""
        return self._joints(self.friction)

    def static_force(self, q: Vector) -> Vector:
        """Moments of weight and springs [N m]."""
        weight = self.gravity * (self.masses @ self._arms)
        return -weight * np.sin(q) - self._joints(self.spring) @ q

    def acceleration(self, q: Vector, v: Vector, push: Vector) -> Vector:
        """Angular accelerations [rad/s^2]; the centrifugal term is the exact one of :meth:`mass`."""
        centrifugal = (self._moments * np.sin(q[:, None] - q[None, :])) @ v**2
        force = self.static_force(q) - centrifugal - self.damping() @ v + push
        return np.linalg.solve(self.mass(q), force)

    def potential_energies(self, states: Series) -> Float64[np.ndarray, " T"]:
        """Energy [J], zero where all links hang straight down."""
        weight = self.gravity * (self.masses @ self._arms)
        elastic = 0.5 * np.einsum("ti,ij,tj->t", states, self._joints(self.spring), states)
        return (1 - np.cos(states)) @ weight + elastic

    def poses(self, states: Series) -> Poses:
        """Hinges of the links, the pivot at (0, 0). A positive angle swings to the right."""
        along = np.stack([np.sin(states), np.cos(states)], axis=2) * self.length[:, None]
        hinges = np.concatenate([np.zeros_like(along[:, :1]), np.cumsum(along, axis=1)[:, :-1]], axis=1)
        return np.concatenate([hinges, -states[:, :, None]], axis=2)


@dataclass(frozen=True)
class Rocker:
    """Rolling without slip on level ground; the coordinate is the rolled angle [rad], clockwise."""

    radius: float  # of the runner [m]
    depth: float  # of the centre of mass below the runner's centre [m]
    body_mass: float  # [kg]
    inertia: float  # about the centre of mass [kg m^2]
    friction: float  # of rolling [N m s/rad]
    gravity: float

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Name of the rolled angle, with its unit."""
        return ("angle [rad]",)

    def mass(self, q: Vector) -> Matrix:
        """Inertia about the point of contact [kg m^2]; it depends on the angle."""
        reach = self.radius**2 + self.depth**2 - 2 * self.radius * self.depth * np.cos(q[0])
        return np.array([[self.inertia + self.body_mass * reach]])

    def damping(self) -> Matrix:
        """Constant viscous damping [N m s/rad]."""
        return np.array([[self.friction]])

    def static_force(self, q: Vector) -> Vector:
        """Moment of the weight about the point of contact [N m]."""
        return -self.body_mass * self.gravity * self.depth * np.sin(q)

    def acceleration(self, q: Vector, v: Vector, push: Vector) -> Vector:
        """Angular acceleration [rad/s^2]."""
        centrifugal = self.body_mass * self.radius * self.depth * np.sin(q) * v**2
        return (self.static_force(q) - centrifugal - self.friction * v + push) / self.mass(q)[0, 0]

    def potential_energies(self, states: Series) -> Float64[np.ndarray, " T"]:
        """Energy [J], zero at rest."""
        return self.body_mass * self.gravity * self.depth * (1 - np.cos(states[:, 0]))

    def poses(self, states: Series) -> Poses:
        """The runner's centre: ``radius`` above the ground (y = 0), moving with the rolling."""
        angle = states[:, 0]
        return np.stack([self.radius * angle, np.full_like(angle, -self.radius), angle], axis=1)[:, None]


Mechanism = Linkage | Rocker


def make_mechanism(config: ReleaseConfig) -> Mechanism:
    """The mechanism that this configuration describes."""
    if config.rocker is not None:
        return Rocker(**asdict(config.rocker), gravity=config.gravity)
    assert config.linkage is not None, "the configuration gives one of the two"
    links = {name: np.array(values) for name, values in asdict(config.linkage).items()}
    return Linkage(**links, gravity=config.gravity)


def find_rest_state(mechanism: Mechanism) -> Vector:
    """The stable rest state nearest to zero, where Newton's method begins."""
    rest = dynamics.find_stable_rest(mechanism.static_force, np.zeros(len(mechanism.coordinates)))
    if rest is None:
        raise ValueError("the mechanism has no stable rest state near zero; check its geometry and masses")
    return rest


def compute_free_modes(mechanism: Mechanism) -> VibrationModes:
    """Linear modes about the rest state."""
    rest = find_rest_state(mechanism)
    stiffness = dynamics.compute_stiffness(mechanism.static_force, rest)
    symmetric = 0.5 * (stiffness + stiffness.T)
    return dynamics.compute_vibration_modes(mechanism.mass(rest), mechanism.damping(), symmetric)


def release(
    mechanism: Mechanism, q: Vector, v: Vector, *, time_s: Float64[np.ndarray, " T"], push: Push, rtol: float
) -> tuple[Series, Series]:
    """Coordinates and velocities under ``push``, as `integrate_motion`."""
    d = len(q)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        now, speed = state[:d], state[d:]
        return np.concatenate([speed, mechanism.acceleration(now, speed, push(t, now))])

    return dynamics.integrate_motion(rate, q, v, time_s, rtol=rtol, atol=1e-3 * rtol, max_step_s=0.02)
