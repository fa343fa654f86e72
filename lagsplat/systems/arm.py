"""The pneumatic arm as a mechanical system: energies, forces, equilibrium and linear modes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.systems import chain, dynamics
from lagsplat.systems.chain import Table
from lagsplat.systems.config import ArmConfig
from lagsplat.systems.dynamics import Matrix, Vector, VibrationModes


@dataclass(frozen=True)
class Arm:
    """A hanging arm; coordinates ``(theta_1, eps_1, ...)`` are bending angle [rad] and strain per segment."""

    table: Table
    gravity: float

    @property
    def d(self) -> int:
        """Number of coordinates, two per segment; also the number of chambers."""
        return 2 * self.table.shape[0]

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Bending angle and strain of each segment."""
        segments = range(1, self.table.shape[0] + 1)
        return tuple(name for i in segments for name in (f"bend {i} [rad]", f"strain {i}"))

    def mass(self, q: Vector) -> Matrix:
        """Mass matrix at ``q``, in SI units of the coordinates."""
        return chain.chain_inertia(q, np.zeros_like(q), self.table, self.gravity)[0]

    def damping(self) -> Matrix:
        """Constant viscous damping matrix."""
        return np.diag(self.table[:, [chain.C_BEND, chain.C_EXT]].ravel())

    def static_force(self, q: Vector, pressure: Vector) -> Vector:
        """Generalised weight, elastic and chamber force at rest; ``pressure`` [atm]."""
        weight = chain.chain_inertia(q, np.zeros_like(q), self.table, self.gravity)[2]
        work = chain.chamber_volumes(q, self.table)[1].T @ pressure
        return weight + chain.elastic_force(q, self.table) + chain.ATMOSPHERE_PA * work

    def acceleration(self, q: Vector, v: Vector, pressure: Vector) -> Vector:
        """Second derivative of the coordinates [1/s^2]; ``pressure`` [atm]."""
        return chain.acceleration(q, v, pressure, self.table, self.gravity)

    def potential_energies(self, states: Float64[np.ndarray, "T d"]) -> Float64[np.ndarray, " T"]:
        """Elastic plus gravitational energy [J] of each state; zero when undeformed at the clamp's height."""
        x = states.reshape(len(states), -1, 2)
        k, h = self.table[:, [chain.K_BEND, chain.K_EXT]], self.table[:, [chain.H_BEND, chain.H_EXT]]
        elastic = np.sum(0.5 * k * x**2 + 0.25 * k * h * x**4, axis=(1, 2))
        return elastic - self.gravity * self._mass_times_depth(states)

    def equilibrium(self, pressure: Vector) -> Vector:
        """Rest pose under constant ``pressure`` [atm], by Newton's method from the straight arm.

        Raises:
            ValueError: no stable equilibrium is found, as under pressures that the springs cannot balance.
        """
        rest = dynamics.find_stable_rest(lambda q: self.static_force(q, pressure), np.zeros(self.d))
        if rest is None:
            raise ValueError(
                f"no stable rest pose under pressures {pressure} atm: the springs cannot hold the arm; lower "
                "the pressures or raise arm.bending_stiffness and arm.extension_stiffness"
            )
        return rest

    def modes(self, pressure: Vector | None = None) -> VibrationModes:
        """Free modes of the arm linearised about its rest pose under constant ``pressure`` [atm], or none."""
        held = np.zeros(self.d) if pressure is None else pressure
        rest = self.equilibrium(held)
        stiffness = dynamics.compute_stiffness(lambda q: self.static_force(q, held), rest)
        return dynamics.compute_vibration_modes(self.mass(rest), self.damping(), stiffness)

    def _mass_times_depth(self, states: Float64[np.ndarray, "T d"]) -> Float64[np.ndarray, " T"]:
        total, origin = np.zeros(len(states)), np.zeros(len(states), complex)
        orientation = np.ones(len(states), complex)
        fine, weights = chain.LEGENDRE_NODES, chain.LEGENDRE_WEIGHTS
        for row, bend, ext in zip(self.table, states[:, 0::2].T, states[:, 1::2].T, strict=True):
            length = row[chain.LENGTH] * (1 + ext)
            for node, weight in zip(chain.NODES, chain.WEIGHTS, strict=True):
                # Quadrature instead of `chain.arc`: independent of the code behind the forces.
                arc = np.exp(1j * bend[:, None] * node * 0.5 * (fine + 1)) @ weights * 0.5 * node
                total += row[chain.MASS] * weight * (origin + orientation * length * arc).real
            arc = np.exp(1j * bend[:, None] * 0.5 * (fine + 1)) @ weights * 0.5
            origin = origin + orientation * length * arc
            orientation = orientation * np.exp(1j * bend)
            link = row[chain.LINK_LENGTH]
            total += row[chain.LINK_MASS] * (origin + 0.5 * link * orientation).real
            origin = origin + link * orientation
        return total


def build_arm(config: ArmConfig) -> Arm:
    """The arm that this configuration describes, with filled rectangular sections in the plane of motion."""
    n = len(config.length)
    gyration = config.half_width**2 / 3
    table = np.zeros((n, chain.N_COLUMNS))
    table[:, chain.LENGTH] = config.length
    table[:, chain.MASS] = config.mass
    table[:, chain.GYRATION] = gyration
    table[:, chain.K_BEND] = config.bending_stiffness
    table[:, chain.H_BEND] = config.bending_hardening
    table[:, chain.K_EXT] = config.extension_stiffness
    table[:, chain.H_EXT] = config.extension_hardening
    table[:, chain.AREA] = config.chamber_area
    table[:, chain.OFFSET] = config.chamber_offset
    table[:, chain.LIMIT] = config.chamber_limit
    table[:, chain.LINK_LENGTH] = config.link_length
    table[:, chain.LINK_MASS] = config.link_mass
    table[:, [chain.C_BEND, chain.C_EXT]] = config.retardation_s * table[:, [chain.K_BEND, chain.K_EXT]]
    link = table[:, chain.LINK_LENGTH] ** 2 / 12 + gyration
    table[:, chain.LINK_INERTIA] = table[:, chain.LINK_MASS] * link
    return Arm(table, config.gravity)
