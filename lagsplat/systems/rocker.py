"""A body that rolls to and fro on a circular runner: a rocking toy, a rocking chair."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.systems.mechanism import Matrix, Poses, Series, Vector


@dataclass(frozen=True)
class Rocker:
    """Rolling without slip on level ground; the coordinate is the angle it has rolled [rad], clockwise.

    ``radius`` [m] of the runner, ``depth`` [m] of the centre of mass below the runner's centre, ``body_mass``
    [kg], ``inertia`` [kg m^2] about the centre of mass, ``friction`` [N m s/rad] of rolling.
    """

    radius: float
    depth: float
    body_mass: float
    inertia: float
    friction: float
    gravity: float

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The angle."""
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
        """The runner's centre: above the ground (y = 0) by the radius, and along with the rolling."""
        angle = states[:, 0]
        return np.stack([self.radius * angle, np.full_like(angle, -self.radius), angle], axis=1)[:, None]
