"""Equilibria, linear modes and motions of any mechanical system that is given by its forces."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.integrate import solve_ivp

STEP = 1e-5  # of a coordinate in central differences

Vector = Float64[np.ndarray, " d"]
Matrix = Float64[np.ndarray, "d d"]
Series = Float64[np.ndarray, "T d"]


@dataclass(frozen=True)
class VibrationModes:
    """Linear free modes at rest, slowest first, of eigenvalues ``lambda``."""

    natural_hz: Float64[np.ndarray, " n_modes"]  # |lambda| / 2 pi
    damped_hz: Float64[np.ndarray, " n_modes"]  # frequency of the decaying motion
    decay_per_s: Float64[np.ndarray, " n_modes"]  # rate of its envelope
    damping_ratio: Float64[np.ndarray, " n_modes"]  # decay / |lambda|


def compute_vibration_modes(mass: Matrix, damping: Matrix, stiffness: Matrix) -> VibrationModes:
    """Oscillating solutions of ``M x'' + C x' + K x = 0``; overdamped directions are left out."""
    d = len(mass)
    inverse = np.linalg.inv(mass)
    lower = np.hstack([-inverse @ stiffness, -inverse @ damping])
    upper = np.hstack([np.zeros((d, d)), np.eye(d)])
    roots = np.linalg.eigvals(np.vstack([upper, lower]))
    roots = roots[roots.imag > 0]
    roots = roots[np.argsort(np.abs(roots))]
    size = np.abs(roots)
    return VibrationModes(size / (2 * np.pi), roots.imag / (2 * np.pi), -roots.real, -roots.real / size)


def differentiate(function: Callable[[Series], np.ndarray], q: Vector) -> np.ndarray:
    """Derivatives (d, ...) by ``q`` of a function of many states (T, d), by central differences."""
    steps = STEP * np.eye(len(q))
    ahead, behind = np.split(function(q + np.concatenate([steps, -steps])), 2)
    return (ahead - behind) / (2 * STEP)


def compute_stiffness(force: Callable[[Vector], Vector], q: Vector) -> Matrix:
    """Minus the derivative of a force, by central differences (relative error near 1e-10)."""
    columns = [(force(q - STEP * e) - force(q + STEP * e)) / (2 * STEP) for e in np.eye(len(q))]
    return np.stack(columns, axis=1)


def find_stable_rest(
    force: Callable[[Vector], Vector],
    q: Vector,
    *,
    longest_step: float = 0.3,
    tolerance: float = 1e-12,
    iterations: int = 50,
) -> Vector | None:
    """The stable zero of ``force`` that Newton's method finds from ``q``, or None."""
    for _ in range(iterations):
        slope = compute_stiffness(force, q)
        if not np.isfinite(slope).all():
            return None
        step = np.linalg.solve(slope, force(q))
        q = q + np.clip(step, -longest_step, longest_step)
        if np.abs(step).max() < tolerance:
            return q if np.linalg.eigvalsh(0.5 * (slope + slope.T))[0] > 0 else None
    return None


def integrate_motion(
    rate: Callable[..., np.ndarray],
    q: Vector,
    v: Vector,
    time_s: Float64[np.ndarray, " T"],
    *,
    rtol: float,
    atol: float,
    max_step_s: float,
    method: str = "DOP853",
    args: tuple[Any, ...] = (),
) -> tuple[Series, Series]:
    """Coordinates and velocities at ``time_s`` from ``(q, v)`` at the first of them.

    ``rate(t, state, *args)`` is the derivative of the state (2 d,); ``max_step_s`` keeps the solver from
    stepping over a short force.

    Raises:
        RuntimeError: the solver failed, or the motion is not finite.

    Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (DOP853).
    """
    solution = solve_ivp(
        rate,
        (time_s[0], time_s[-1]),
        np.concatenate([q, v]),
        method=method,
        t_eval=time_s,
        rtol=rtol,
        atol=atol,
        max_step=max_step_s,
        args=args,
    )
    if not solution.success or not np.isfinite(solution.y).all():
        reached_s = solution.t[-1] if solution.t.size else time_s[0]
        raise RuntimeError(f"integration stopped at t = {reached_s:.3f} s: {solution.message}")
    states = np.ascontiguousarray(solution.y.T)
    return states[:, : len(q)].copy(), states[:, len(q) :].copy()
