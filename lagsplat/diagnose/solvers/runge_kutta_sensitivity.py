"""Rollouts of a simulator with their derivatives by its coefficients and by the initial states, compiled.

The sensitivities ``S`` of the state obey ``dS/dt = J S + [0; M^-1 g]``, ``J`` being the Jacobian of the rate
by the state and ``g`` the generalised force of one unit of a coefficient, its inertia included. They pass
through the same Runge-Kutta stages as the state, so that they are the exact derivatives of the rollouts of
`lagsplat.diagnose.solvers.runge_kutta`. Only the simulator itself is rolled out here, without added forces.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., I.14 and II.6.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from lagsplat.diagnose.mechanics.basis import differentiate_basis, evaluate_basis
from lagsplat.diagnose.solvers.cholesky import factorize_single, solve_single
from lagsplat.diagnose.solvers.runge_kutta import DIVERGED_SCALES
from lagsplat.diagnose.solvers.threads import run_in_threads


@njit(cache=True, error_model="numpy", inline="always")
@no_type_check
def _compute_forces(fields, phi, slope, state, u, rate, m):
    """Write velocities and generalised forces of the simulator into ``rate``, its mass into ``m``, compiled.

    Args:
        fields: mass, damping, potential, input map, dry friction, drag, friction width and rest.
        phi, slope: values (K,) and gradients (d, K) of the functions.
        state, u: coordinates and velocities (2 d,), inputs (n_u,).
        rate: velocities and forces (2 d,), written.
        m: the mass matrix (d, d), of which the lower triangle is written.
    """
    mass, damping, potential, input_map, dry, drag, width, rest = fields
    d, n_u = rest.shape[0], input_map.shape[0]
    for i in range(d):
        rate[i] = state[d + i]
        rate[d + i] = -drag[i] * abs(state[d + i]) * state[d + i]
        if dry[i] != 0.0:
            rate[d + i] -= dry[i] * math.tanh(state[d + i] / width[i])
        for k in range(potential.shape[0]):
            rate[d + i] -= potential[k] * slope[i, k]
        for c in range(n_u):
            for k in range(input_map.shape[2]):
                rate[d + i] += phi[k] * input_map[c, i, k] * u[c]
        for j in range(d):
            loss = 0.0
            for k in range(damping.shape[2]):
                loss += phi[k] * damping[i, j, k]
            rate[d + i] -= loss * state[d + j]
    for i in range(d):
        for j in range(i + 1):
            inert = 0.0
            for k in range(mass.shape[2]):
                inert += phi[k] * mass[i, j, k]
            m[i, j] = inert
            for n in range(d):
                change = 0.0
                for k in range(mass.shape[2]):
                    change += slope[n, k] * mass[i, j, k]
                rate[d + i] -= state[d + n] * change * state[d + j]
                rate[d + n] += (0.5 if i == j else 1.0) * state[d + i] * change * state[d + j]
                if i != j:
                    rate[d + j] -= state[d + n] * change * state[d + i]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _jacobian(fields, state, u, a, phi, slope, curvature, parts, out):
    """Write the derivatives (d, 2 d) of ``forces - M a`` by the state, at a constant acceleration.

    ``parts`` (2 + 3 d, K) is scratch. It holds for every function of the basis the factor of its slope and of
    its curvature, its rate along the motion, and the products of mass and of curvature with the velocity.
    """
    mass, damping, potential, input_map, dry, drag, width, _ = fields
    d, n_v = dry.shape[0], mass.shape[2]
    parts[:] = 0.0
    curvature_factor, phi_rate = parts[0], parts[1]
    slope_factor, momentum, curvature_rate = parts[2 : 2 + d], parts[2 + d : 2 + 2 * d], parts[2 + 2 * d :]
    for k in range(potential.shape[0]):
        curvature_factor[k] -= potential[k]
    for i in range(d):
        for j in range(d):
            mass_ij = mass[max(i, j), min(i, j)]
            for k in range(n_v):
                slope_factor[i, k] -= mass_ij[k] * a[d + j]
                momentum[i, k] += mass_ij[k] * state[d + j]
                curvature_rate[i, k] += curvature[i, j, k] * state[d + j]
            for k in range(damping.shape[2]):
                slope_factor[i, k] -= damping[i, j, k] * state[d + j]
        for c in range(input_map.shape[0]):
            for k in range(input_map.shape[2]):
                slope_factor[i, k] += input_map[c, i, k] * u[c]
        for k in range(n_v):
            phi_rate[k] += slope[i, k] * state[d + i]
            curvature_factor[k] += 0.5 * momentum[i, k] * state[d + i]
    for i in range(d):
        for j in range(d):
            by_q, by_v = 0.0, 0.0
            for k in range(phi.shape[0]):
                by_q += slope[j, k] * slope_factor[i, k] + curvature[i, j, k] * curvature_factor[k]
            for k in range(n_v):
                by_q -= curvature_rate[j, k] * momentum[i, k]
                by_v += slope[i, k] * momentum[j, k] - slope[j, k] * momentum[i, k]
                by_v -= phi_rate[k] * mass[max(i, j), min(i, j), k]
            for k in range(damping.shape[2]):
                by_v -= phi[k] * damping[i, j, k]
            out[i, j], out[i, d + j] = by_q, by_v
        out[i, d + i] -= 2.0 * drag[i] * abs(state[d + i])
        if dry[i] != 0.0:
            out[i, d + i] -= dry[i] / width[i] * (1.0 - math.tanh(state[d + i] / width[i]) ** 2)


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _add_units(columns, width, state, u, a, phi, slope, g):
    """Add to ``g`` (d, C) the derivative of ``forces - M a`` by every coefficient, column by column."""
    mass, damping, potential, input_map, dry, drag = columns
    d = width.shape[0]
    for k in range(potential.shape[0]):
        at = potential[k]
        for i in range(d if at >= 0 else 0):
            g[i, at] -= slope[i, k]
    for i in range(d):
        v = state[d + i]
        if dry[i] >= 0:
            g[i, dry[i]] -= math.tanh(v / width[i])
        if drag[i] >= 0:
            g[i, drag[i]] -= abs(v) * v
        for j in range(d):
            for k in range(damping.shape[2]):
                if damping[i, j, k] >= 0:
                    g[i, damping[i, j, k]] -= phi[k] * state[d + j]
        for c in range(input_map.shape[0]):
            for k in range(input_map.shape[2]):
                if input_map[c, i, k] >= 0:
                    g[i, input_map[c, i, k]] += phi[k] * u[c]
        for j in range(i + 1):
            kinetic = (0.5 if i == j else 1.0) * v * state[d + j]
            for k in range(mass.shape[2]):
                at = mass[i, j, k]
                if at < 0:
                    continue
                phi_rate = 0.0
                for n in range(d):
                    phi_rate += slope[n, k] * state[d + n]
                    g[n, at] += kinetic * slope[n, k]
                g[i, at] -= phi[k] * a[d + j] + phi_rate * state[d + j]
                if i != j:
                    g[j, at] -= phi[k] * a[d + i] + phi_rate * v


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _tangent(jacobian, m, g, s, unit, rate):
    """Write the rate (2 d, C) of the sensitivities ``s``; ``m`` is factorised, ``g`` is overwritten."""
    d, n = g.shape
    for i in range(d):
        for j in range(2 * d):
            factor = jacobian[i, j]
            for c in range(n):
                g[i, c] += factor * s[j, c]
        for c in range(n):
            rate[i, c] = s[d + i, c]
            rate[d + i, c] = 0.0
    for j in range(d):
        unit[:] = 0.0
        unit[d + j] = 1.0
        solve_single(m, unit, d)
        for i in range(d):
            factor = unit[d + i]
            for c in range(n):
                rate[d + i, c] += factor * g[j, c]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _rates(basis, fields, columns, x, s, u, scratch, rate, s_rate):
    """Write the rates of the state ``x`` (2 d,) and of its sensitivities ``s`` (2 d, C)."""
    phi, scaled, waves, slope, curvature, parts, jacobian, m, unit, g = scratch
    d = m.shape[0]
    evaluate_basis(basis, x[:d].reshape(d, 1), scaled, waves, phi.reshape(len(phi), 1))
    differentiate_basis(basis, phi, slope, curvature)
    _compute_forces(fields, phi, slope, x, u, rate, m)
    factorize_single(m, d)
    solve_single(m, rate, d)
    _jacobian(fields, x, u, rate, phi, slope, curvature, parts, jacobian)
    g[:] = 0.0
    _add_units(columns, fields[6], x, u, rate, phi, slope, g)
    _tangent(jacobian, m, g, s, unit, s_rate)


@njit(cache=True)
@no_type_check
def _scratch(basis, d, n_c):
    """Work arrays of `_rates` for ``d`` coordinates and ``n_c`` columns."""
    n = basis[0].shape[0]
    values = np.empty(n), np.empty((d, 1)), np.empty((2, d, 1)), np.empty((d, n)), np.empty((d, d, n))
    parts, jacobian = np.empty((2 + 3 * d, n)), np.empty((d, 2 * d))
    return *values, parts, jacobian, np.empty((d, d)), np.empty(2 * d), np.empty((d, n_c))


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"}, nogil=True)
@no_type_check
def _roll(basis, fields, columns, n_columns, start, time, u, steps, out, slopes):
    """Roll out a single window, whose ``time`` and ``u`` are given."""
    rest, n_frames = fields[7], time.shape[0]
    d, n_c = rest.shape[0], slopes.shape[2]
    scratch = _scratch(basis, d, n_c)
    x, y, total, rate = start.copy(), np.empty(2 * d), np.empty(2 * d), np.zeros(2 * d)
    s, s_stage = np.zeros((2 * d, n_c)), np.empty((2 * d, n_c))
    s_total, s_rate = np.empty((2 * d, n_c)), np.zeros((2 * d, n_c))
    for i in range(2 * d):
        s[i, n_columns + i] = 1.0
    lost = False
    for frame in range(n_frames):
        for i in range(d):
            out[frame, i] = x[i]
            for c in range(n_c):
                slopes[frame, i, c] = s[i, c]
        for step in range(steps if frame < n_frames - 1 and not lost else 0):
            h = (time[frame + 1] - time[frame]) / steps
            for stage in range(4):
                at = 0 if stage == 0 else (2 if stage == 3 else 1)
                share, weight = 0.5 * at * h, 2.0 if at == 1 else 1.0
                for i in range(2 * d):
                    y[i] = x[i] + share * rate[i]
                    for c in range(n_c):
                        s_stage[i, c] = s[i, c] + share * s_rate[i, c]
                _rates(basis, fields, columns, y, s_stage, u[frame, step, at], scratch, rate, s_rate)
                if stage == 0:
                    total[:] = 0.0
                    s_total[:] = 0.0
                for i in range(2 * d):
                    total[i] += weight * rate[i]
                    for c in range(n_c):
                        s_total[i, c] += weight * s_rate[i, c]
            for i in range(2 * d):
                x[i] += h / 6.0 * total[i]
                for c in range(n_c):
                    s[i, c] += h / 6.0 * s_total[i, c]
            for i in range(d):
                if not abs(x[i] - rest[i]) < DIVERGED_SCALES * basis[3][i]:
                    lost = True
        if lost:
            for i in range(d):
                x[i] = rest[i] + DIVERGED_SCALES * basis[3][i]
                x[d + i] = 0.0
            s[:] = 0.0


@no_type_check
def roll_out_with_sensitivities(
    basis, fields, columns, n_columns, starts, first, length, time, u, steps, out, slopes
):
    """Write the coordinates of every window and their derivatives, compiled and in threads.

    Args:
        basis, fields: as `roll_out_batch` of `lagsplat.diagnose.solvers.runge_kutta` takes them, but without
            the first axis.
        columns: shaped as the first six of ``fields``, the column of each coefficient's derivative or -1 for
            none; coefficients of one column move together.
        n_columns: number of these columns, C.
        starts, first, length: initial state (W, 2 d), first frame and number of frames (W,) of each window.
        time: times of all frames (N,) [s].
        u: inputs (N, steps, 3, n_u) at the start, middle and end of every substep.
        steps: Runge-Kutta steps between two frames.
        out: coordinates (W, L, d), written. A diverged rollout stays where it is lost.
        slopes: derivatives (W, L, d, C + 2 d), written: by the columns, then by the initial state. Those of a
            diverged rollout are zero.
    """

    def roll_out(windows: np.ndarray) -> None:
        for w in windows:
            span = slice(first[w], first[w] + length[w])
            _roll(basis, fields, columns, n_columns, starts[w], time[span], u[span], steps, out[w], slopes[w])

    run_in_threads(roll_out, len(first))
