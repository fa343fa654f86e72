"""Integration of the arm under smooth pressures, by an eighth-order Runge-Kutta pair."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit
from scipy.integrate import solve_ivp

from lagsplat.systems import chain
from lagsplat.systems.arm import Arm
from lagsplat.systems.drive import spline_coefficients


@njit(cache=True)
@no_type_check
def rate(t, state, spline, dt_s, table, nodes, weights, gravity):
    """Velocities and accelerations of the arm under the spline of its pressures [atm]."""
    d = state.size // 2
    i = min(max(int(t / dt_s), 0), spline.shape[1] - 1)
    x = t - i * dt_s
    pressure = ((spline[0, i] * x + spline[1, i]) * x + spline[2, i]) * x + spline[3, i]
    q, v = state[:d], state[d:]
    out = np.empty(2 * d)
    out[:d] = v
    out[d:] = chain.acceleration(q, v, pressure, table, nodes, weights, gravity)
    return out


def integrate(
    arm: Arm,
    q: Float64[np.ndarray, " d"],
    v: Float64[np.ndarray, " d"],
    pressures: Float64[np.ndarray, "n_frames n_inputs"],
    *,
    dt_s: float,
    rtol: float,
    atol: float,
) -> tuple[Float64[np.ndarray, "n_frames d"], Float64[np.ndarray, "n_frames d"]]:
    """Coordinates and velocities at the frames, from the state ``(q, v)`` at the first one.

    ``pressures`` [atm] at the frames act as their cubic spline between them.

    Raises:
        RuntimeError: the solver gave up, which means that the arm left its physical range.

    Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (DOP853).
    """
    spline = spline_coefficients(pressures, dt_s=dt_s)
    times = np.arange(len(pressures)) * dt_s
    try:
        # At rest the solver would stretch its step over the whole beginning of the drive, hence `max_step`.
        solution = solve_ivp(
            rate, (0.0, times[-1]), np.concatenate([q, v]), method="DOP853", t_eval=times, rtol=rtol,
            atol=atol, max_step=3 * dt_s,
            args=(spline, dt_s, arm.table, arm.nodes, arm.weights, arm.gravity),
        )  # fmt: skip
    except np.linalg.LinAlgError as error:
        raise _out_of_range("the mass matrix is no longer finite") from error
    if not solution.success or not np.all(np.isfinite(solution.y)):
        raise _out_of_range(f"at t = {solution.t[-1]:.3f} s, {solution.message}")
    states = np.ascontiguousarray(solution.y.T)
    return states[:, : arm.d].copy(), states[:, arm.d :].copy()


def _out_of_range(found: str) -> RuntimeError:
    return RuntimeError(
        f"integration of the arm stopped ({found}): it was driven out of its physical range; lower "
        "simulation.drive_max_atm or stiffen the arm."
    )
