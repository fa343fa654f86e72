"""What a planar mechanism without inputs has to say of itself, and its free motion.

Positions are metres, x to the right and y down, in the plane of motion. A body's pose is where its own origin
is and by how much it is turned, clockwise as seen.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from jaxtyping import Float64
from scipy.integrate import solve_ivp

from lagsplat.systems.truth import VibrationModes, compute_vibration_modes

Vector = Float64[np.ndarray, " d"]
Matrix = Float64[np.ndarray, "d d"]
Series = Float64[np.ndarray, "T d"]
Poses = Float64[np.ndarray, "T n_bodies 3"]
"""x [m], y [m] and angle [rad] of every body."""
Push = Callable[[float, Vector], Vector]
"""Generalised force at a time [s] and state."""
STEP = 1e-5


class Mechanism(Protocol):
    """A mechanical system with the coordinates of a vector ``q``; SI units."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Name and unit of each coordinate."""

    def mass(self, q: Vector) -> Matrix:
        """Mass matrix."""

    def damping(self) -> Matrix:
        """Constant viscous damping matrix."""

    def static_force(self, q: Vector) -> Vector:
        """Generalised weight and elastic force at rest."""

    def acceleration(self, q: Vector, v: Vector, push: Vector) -> Vector:
        """Second derivative of the coordinates under a generalised force ``push``."""

    def potential_energies(self, states: Series) -> Float64[np.ndarray, " T"]:
        """Elastic plus gravitational energy [J] of each state."""

    def poses(self, states: Series) -> Poses:
        """Where the bodies are."""


def find_rest_state(mechanism: Mechanism) -> Vector:
    """The stable rest state, by Newton from zero.

    Raises:
        ValueError: there is none near zero.
    """
    q = np.zeros(len(mechanism.coordinates))
    for _ in range(50):
        step = np.linalg.solve(rest_stiffness(mechanism, q), mechanism.static_force(q))
        q = q + np.clip(step, -0.3, 0.3)
        if np.max(np.abs(step)) < 1e-12:
            break
    if np.max(np.abs(step)) < 1e-12 and np.linalg.eigvalsh(rest_stiffness(mechanism, q))[0] > 0:
        return q
    raise ValueError("the mechanism has no stable rest state near zero; check its geometry and masses")


def rest_stiffness(mechanism: Mechanism, q: Vector) -> Matrix:
    """Minus the derivative of the static force, by central differences, symmetric."""
    columns = [
        (mechanism.static_force(q - STEP * e) - mechanism.static_force(q + STEP * e)) / (2 * STEP)
        for e in np.eye(len(q))
    ]
    matrix = np.stack(columns, axis=1)
    return 0.5 * (matrix + matrix.T)


def compute_free_modes(mechanism: Mechanism) -> VibrationModes:
    """Linear modes about the rest state."""
    rest = find_rest_state(mechanism)
    return compute_vibration_modes(mechanism.mass(rest), mechanism.damping(), rest_stiffness(mechanism, rest))


def release_from_rest(
    mechanism: Mechanism, q: Vector, v: Vector, *, time_s: Float64[np.ndarray, " T"], push: Push, rtol: float
) -> tuple[Series, Series]:
    """Coordinates and velocities at ``time_s`` from ``(q, v)`` at the first of them.

    Raises:
        RuntimeError: the solver gave up.

    Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (DOP853).
    """
    d = len(q)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        now, speed = state[:d], state[d:]
        return np.concatenate([speed, mechanism.acceleration(now, speed, push(t, now))])

    # A push is over sooner than a free swing would need a step, hence the limit.
    solution = solve_ivp(
        rate,
        (time_s[0], time_s[-1]),
        np.concatenate([q, v]),
        method="DOP853",
        t_eval=time_s,
        rtol=rtol,
        atol=1e-3 * rtol,
        max_step=0.02,
    )
    if not solution.success or not np.all(np.isfinite(solution.y)):
        raise RuntimeError(f"integration stopped at t = {solution.t[-1]:.3f} s: {solution.message}")
    states = np.ascontiguousarray(solution.y.T)
    return states[:, :d].copy(), states[:, d:].copy()
