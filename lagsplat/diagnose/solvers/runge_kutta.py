"""The classical Runge-Kutta method: compiled rollouts of a simulator with added forces.

A batch is ``P`` sets of parameters times ``W`` windows of a recording. An added force acts along a direction
``p`` and sees a direction ``w``, which is ``p`` unless it couples coordinates: with ``s = w.(q - rest)`` its
law returns an acceleration ``f(t, s, ds/dt, ...)``, and ``p m f`` is added to the generalised forces, ``m``
being the reference inertia along ``p``. Force laws are compiled one by one and passed as functions, so that a
new effect compiles alone.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.1.
"""

import math
from typing import Any, no_type_check

import numpy as np
from numba import float64, njit, prange, types

from lagsplat.diagnose.mechanics.basis import evaluate_basis, find_highest_power

VECTOR, MATRIX, CUBE = float64[::1], float64[:, ::1], float64[:, :, ::1]
FORCE_LAW_SIGNATURE = float64(float64, float64, float64, float64, float64, VECTOR, VECTOR, VECTOR)
"""``law(t, s, v, spring, drive, memory, theta, d_memory) -> acceleration``; writes the rate of its memory."""
MEMORY_SIGNATURE = types.void(
    types.FunctionType(FORCE_LAW_SIGNATURE), MATRIX, VECTOR, MATRIX, types.int64[:, ::1], CUBE, CUBE
)
"""Signature of `integrate_memory`, which takes any law and is so compiled once."""
DIVERGED_SCALES = 1e6  # distance from rest beyond which a rollout has diverged [scale of the coordinate]
MEMORY_STEPS = 8  # midpoint steps of a force law's memory between two frames
MIN_PIVOT = 1e-12  # floor of a squared pivot, so that a mass matrix that is not positive gives no NaN


def compile_force_law(function: Any) -> Any:
    """Compile a force law under the signature that all of them share; a decorator."""
    return njit(FORCE_LAW_SIGNATURE, cache=True)(function)


@compile_force_law
@no_type_check
def zero_force(t, s, v, spring, drive, memory, theta, d_memory):
    """A force law that is zero, for the slots that no effect uses."""
    return 0.0


@njit(cache=True)
@no_type_check
def factorize_cholesky(a, d):
    """Overwrite the lower triangle of a symmetric ``a`` (d, d) with its Cholesky factor, compiled."""
    for j in range(d):
        for k in range(j):
            a[j, j] -= a[j, k] * a[j, k]
        a[j, j] = math.sqrt(max(a[j, j], MIN_PIVOT))
        for i in range(j + 1, d):
            for k in range(j):
                a[i, j] -= a[i, k] * a[j, k]
            a[i, j] /= a[j, j]


@njit(cache=True)
@no_type_check
def solve_cholesky(a, b, d):
    """Overwrite the second half of ``b`` (2 d,) with the solution for the Cholesky factor ``a``, compiled."""
    for i in range(d):
        for k in range(i):
            b[d + i] -= a[i, k] * b[d + k]
        b[d + i] /= a[i, i]
    for i in range(d - 1, -1, -1):
        for k in range(i + 1, d):
            b[d + i] -= a[k, i] * b[d + k]
        b[d + i] /= a[i, i]


@njit(cache=True, error_model="numpy", inline="always")
@no_type_check
def compute_forces(basis, fields, state, u, rate, phi, slope, work, m, powers):
    """Write velocities and generalised forces of the simulator into ``rate``, its mass into ``m``, compiled.

    Args:
        basis: kind, order, centre and scale of the basis.
        fields: mass, damping, potential, input map, dry friction, drag, friction width and rest.
        state, u: coordinates and velocities (2 d,), more may follow; inputs (n_u,).
        rate, work: velocities and forces (2 d,), conservative and actuated forces (2 d,), written.
        m: the mass matrix (d, d), of which the lower triangle is written.
        phi, slope, powers: scratch for the basis (K,), (d, K), and as `evaluate_basis` takes it.
    """
    kind, order, centre, scale = basis
    mass, damping, potential, input_map, dry, drag, width, rest = fields
    d, n_u = rest.shape[0], input_map.shape[0]
    evaluate_basis(kind, order, centre, scale, state, powers, phi, slope.T)
    for i in range(d):
        rate[i] = state[d + i]
        rate[d + i] = -drag[i] * abs(state[d + i]) * state[d + i]
        if dry[i] != 0.0:
            rate[d + i] -= dry[i] * math.tanh(state[d + i] / width[i])
        spring, drive = 0.0, 0.0
        for k in range(potential.shape[0]):
            spring -= potential[k] * slope[i, k]
        for c in range(n_u):
            for k in range(input_map.shape[2]):
                drive += phi[k] * input_map[c, i, k] * u[c]
        work[i], work[d + i] = spring, drive
        rate[d + i] += spring + drive
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


@njit(cache=True, error_model="numpy", inline="always")
@no_type_check
def _rate(basis, fields, laws, along, seen, inertia, theta, t, state, u, rate, scratch):
    """Write the rate of ``state``: coordinates, velocities and the force laws' memories, slot after slot."""
    phi, slope, work, m, powers = scratch
    rest = fields[7]
    d = rest.shape[0]
    n_z = (state.shape[0] - 2 * d) // inertia.shape[0]
    compute_forces(basis, fields, state, u, rate, phi, slope, work, m, powers)
    for slot in range(inertia.shape[0]):
        if inertia[slot] == 0.0:
            continue
        s, v, spring, drive = 0.0, 0.0, 0.0, 0.0
        for i in range(d):
            s += seen[slot, i] * (state[i] - rest[i])
            v += seen[slot, i] * state[d + i]
            spring += along[slot, i] * work[i]
            drive += along[slot, i] * work[d + i]
        reference = inertia[slot]
        at = slice(2 * d + slot * n_z, 2 * d + (slot + 1) * n_z)
        f = laws[slot](t, s, v, spring / reference, drive / reference, state[at], theta[slot], rate[at])
        for i in range(d):
            rate[d + i] += along[slot, i] * reference * f
    factorize_cholesky(m, d)
    solve_cholesky(m, rate, d)


@njit(parallel=True, cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def roll_out_batch(
    basis, fields, laws, along, seen, inertia, theta, memory, starts, first, length, time, u, u_of, steps, out
):
    """Write the states at the frames of every window, for every set of parameters, compiled and in parallel.

    Coefficients have the functions of the basis last, because sums over these are most of the work.

    Args:
        basis: kind, order, centre and scale of the basis.
        fields: mass and damping (P, d, d, K), potential (P, K), input map (P, n_u, d, K), dry friction and
            drag (P, d), speed (d,) below which dry friction is linear, and rest (d,).
        laws, along, seen, inertia: compiled force laws, one a slot, the directions (slots, d) in which they
            act and that they see, and the reference inertia, zero for a slot that is not used.
        theta, memory: parameters of the laws (P, slots, n), and their memory at the windows' starts
            (P, W, slots, Z).
        starts: initial states (P, W, 2 d).
        first, length: first frame of each window and its number of frames (W,).
        time: times of all frames (N,) [s].
        u, u_of: inputs (S, N, steps, 3, n_u) at the start, middle and end of every substep, and which of the
            S signals each set of parameters uses (P,).
        steps: Runge-Kutta steps between two frames.
        out: states (P, W, L, 2 d), written. A diverged rollout stays at `DIVERGED_SCALES`.
    """
    mass, damping, potential, input_map, dry, drag, width, rest = fields
    n_sets, n_windows, two_d = starts.shape
    d = two_d // 2
    for job in prange(n_sets * n_windows):
        p, w = job // n_windows, job % n_windows
        own = (mass[p], damping[p], potential[p], input_map[p], dry[p], drag[p], width, rest)
        k = basis[0].shape[0]
        powers = np.empty((d, find_highest_power(basis[0], basis[1]) + 1))
        scratch = (np.empty(k), np.empty((d, k)), np.empty(2 * d), np.empty((d, d)), powers)
        size = two_d + memory.shape[2] * memory.shape[3]
        x, y, total, rate = np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
        x[:two_d] = starts[p, w]
        x[two_d:] = memory[p, w].ravel()
        lost = False
        for frame in range(length[w]):
            for i in range(two_d):
                out[p, w, frame, i] = x[i]
            n = first[w] + frame
            for step in range(steps if frame < length[w] - 1 and not lost else 0):
                h = (time[n + 1] - time[n]) / steps
                for stage in range(4):
                    at = 0 if stage == 0 else (2 if stage == 3 else 1)  # in half steps
                    for i in range(size):
                        y[i] = x[i] + 0.5 * at * h * rate[i]
                    t, inputs = time[n] + (step + 0.5 * at) * h, u[u_of[p], n, step, at]
                    _rate(basis, own, laws, along, seen, inertia, theta[p], t, y, inputs, rate, scratch)
                    for i in range(size):
                        total[i] = (0.0 if stage == 0 else total[i]) + rate[i] * (2.0 if at == 1 else 1.0)
                for i in range(size):
                    x[i] += h / 6.0 * total[i]
                for i in range(d):
                    if not abs(x[i] - rest[i]) < DIVERGED_SCALES * basis[3][i]:
                        lost = True
            if lost:
                for i in range(d):
                    x[i] = rest[i] + DIVERGED_SCALES * basis[3][i]
                    x[d + i] = 0.0


@njit(MEMORY_SIGNATURE, cache=True)
@no_type_check
def integrate_memory(force, theta, time, motion, clips, begin, out):
    """Write a force law's memory along a recorded motion by the explicit midpoint rule, compiled.

    Args:
        force, theta: the law, and its parameters (P, n).
        time: times of the frames (N,) [s].
        motion: along the law's direction, the coordinate, its rate, and the simulator's conservative and
            actuated acceleration (N, 4); linear between frames.
        clips: first frame and end of each clip (C, 2).
        begin: memory where each clip starts (P, C, Z).
        out: memory at the frames (P, N, Z), written.
    """
    n_sets, _, n_z = out.shape
    rate, y, x = np.zeros(n_z), np.zeros(n_z), np.zeros(4)
    for p in range(n_sets):
        for clip in range(clips.shape[0]):
            z = begin[p, clip].copy()
            for n in range(clips[clip, 0], clips[clip, 1]):
                out[p, n] = z
                if n + 1 == clips[clip, 1]:
                    break
                h = (time[n + 1] - time[n]) / MEMORY_STEPS
                for step in range(MEMORY_STEPS):
                    for half in range(2):
                        share = (step + 0.5 * half) / MEMORY_STEPS
                        y[:] = z
                        if half == 1:
                            y[:] += 0.5 * h * rate
                        t = time[n] + share * MEMORY_STEPS * h
                        for i in range(4):
                            x[i] = motion[n, i] + share * (motion[n + 1, i] - motion[n, i])
                        force(t, x[0], x[1], x[2], x[3], y, theta[p], rate)
                    z = z + h * rate
