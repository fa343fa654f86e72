"""The classical Runge-Kutta method: compiled rollouts of a simulator with added forces.

A batch is ``P`` sets of parameters times ``W`` windows of a recording. An added force acts along a direction
``p`` and sees a direction ``w``, which is ``p`` unless it couples coordinates: with ``s = w.(q - rest)`` its
law returns an acceleration ``f(t, s, ds/dt, ...)``, and ``p m f`` is added to the generalised forces, ``m``
being the reference inertia along ``p``. Dry friction is corrected after every step
(`lagsplat.diagnose.solvers.dry_friction`).

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.1.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from lagsplat.diagnose.mechanics.basis import evaluate_basis
from lagsplat.diagnose.solvers.cholesky import factorize_batch, solve_batch
from lagsplat.diagnose.solvers.dry_friction import correct_dry_friction, settle_bristles
from lagsplat.diagnose.solvers.force_laws import call_law
from lagsplat.diagnose.solvers.threads import run_in_threads

DIVERGED_SCALES = 1e6  # distance from rest beyond which a rollout has diverged [scale of the coordinate]
SIDE_BY_SIDE = 64  # rollouts that one thread steps side by side [count]: their scratch fits the inner caches


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"}, inline="always")
@no_type_check
def _sum_products(a, b, out):
    """Write the sums over the first axis of ``a * b`` (K, R), as far as ``a`` goes."""
    for r in range(len(out)):
        out[r] = a[0, r] * b[0, r]
    for k in range(1, a.shape[0]):
        for r in range(len(out)):
            out[r] += a[k, r] * b[k, r]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _compute_forces(fields, phi, state, u, rate, work, m, a):
    """Write velocities and forces of the simulator into ``rate`` (2 d, R), its mass (d, d, R) into ``m``.

    ``work`` (2 d, R) gets the conservative and the actuated forces; ``a`` (R,) is scratch.
    """
    mass, mass_slope, damping, slope, input_map, drag = fields
    d, n, varies = m.shape[0], len(a), mass.shape[2] > 1
    for i in range(d):
        _sum_products(slope[i], phi, a)
        for r in range(n):
            v = state[d + i, r]
            rate[i, r], work[i, r], work[d + i, r] = v, -a[r], 0.0
            rate[d + i, r] = -a[r] - drag[i, r] * abs(v) * v
        for c in range(input_map.shape[0]):
            _sum_products(input_map[c, i], phi, a)
            for r in range(n):
                work[d + i, r] += a[r] * u[c, r]
        for r in range(n):
            rate[d + i, r] += work[d + i, r]
        for j in range(d):
            _sum_products(damping[i, j], phi, a)
            for r in range(n):
                rate[d + i, r] -= a[r] * state[d + j, r]
    for i in range(d):
        for j in range(i + 1):
            _sum_products(mass[i, j], phi, m[i, j])
            share, other = (0.5, 0.0) if i == j else (1.0, 1.0)
            for k in range(d if varies else 0):
                _sum_products(mass_slope[k, i, j], phi, a)
                for r in range(n):
                    rate[d + i, r] -= state[d + k, r] * a[r] * state[d + j, r]
                for r in range(n):
                    rate[d + k, r] += share * state[d + i, r] * a[r] * state[d + j, r]
                for r in range(n):
                    rate[d + j, r] -= other * state[d + k, r] * a[r] * state[d + i, r]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _add_force_laws(laws, geometry, sets, theta, t, state, memory, work, rate, memory_rate):
    """Add the laws' forces to ``rate`` (2 d, R), and write the rates of their memories (R, slots, Z)."""
    along, seen, inertia, _, contacts, rest = geometry
    d = rest.shape[0]
    for slot in range(inertia.shape[0]):
        reference = inertia[slot]
        for r in range(len(t)):
            s, v, spring, drive = 0.0, 0.0, 0.0, 0.0
            for i in range(d):
                s += seen[slot, i] * (state[i, r] - rest[i])
                v += seen[slot, i] * state[d + i, r]
                spring += along[slot, i] * work[i, r]
                drive += along[slot, i] * work[d + i, r]
            values, z, z_rate = theta[sets[r], slot], memory[r, slot], memory_rate[r, slot]
            share = 1.0
            if contacts[slot] >= 0:
                bent = memory[r, contacts[slot], 0]
                share, v = abs(bent), math.copysign(v, bent)
            f = share * call_law(
                laws[slot], t[r], s, v, spring / reference, drive / reference, z, values, z_rate
            )
            for i in range(d):
                rate[d + i, r] += along[slot, i] * reference * f


@njit(cache=True)
@no_type_check
def _gather(values, sets):
    """The values of the ``sets`` (R,) of parameters, rollouts last."""
    out = np.empty((*values.shape[1:], len(sets)))
    for r in range(len(sets)):
        out[..., r] = values[sets[r]]
    return out


@njit(cache=True)
@no_type_check
def _differentiate(basis, coefficients):
    """Coefficients (d, ..., K', R) of the gradient of fields with ``coefficients`` (..., K, R)."""
    target, factor = basis[4], basis[5]
    k_fields, d, k_slope = coefficients.shape[-2], target.shape[0], 1
    for k in range(k_fields):
        k_slope = max(k_slope, target[:, k].max() + 1)
    out = np.zeros((d, *coefficients.shape[:-2], k_slope, coefficients.shape[-1]))
    for i in range(d):
        for k in range(k_fields):
            if factor[i, k] != 0.0:
                out[i, ..., target[i, k], :] += factor[i, k] * coefficients[..., k, :]
    return out


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _add_memory(memory, share, h, rate, out):
    """Write memories (R, slots, Z) after a ``share`` of the times ``h`` (R,) at a ``rate``."""
    for r, slot, i in np.ndindex(memory.shape):
        out[r, slot, i] = memory[r, slot, i] + share * h[r] * rate[r, slot, i]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _advance(basis, fields, laws, geometry, theta, sets, t, h, u, state, memory, scratch):
    """One Runge-Kutta step of the states (2 d, R) and memories (R, slots, Z) over the times ``h`` (R,).

    ``u`` (3, n_u, R) are the inputs at the start, middle and end of the step.
    """
    phi, x, waves, work, m, a, y, total, rate, z, z_total, z_rate, before = scratch
    before[:] = state
    for stage in range(4):
        at = 0 if stage == 0 else (2 if stage == 3 else 1)  # in half steps
        kept, weight = 0.0 if stage == 0 else 1.0, 2.0 if at == 1 else 1.0
        for i in range(len(state)):
            for r in range(len(h)):
                y[i, r] = state[i, r] + 0.5 * at * h[r] * rate[i, r]
        _add_memory(memory, 0.5 * at, h, z_rate, z)
        evaluate_basis(basis, y, x, waves, phi)
        _compute_forces(fields, phi, y, u[at], rate, work, m, a)
        _add_force_laws(laws, geometry, sets, theta, t + 0.5 * at * h, y, z, work, rate, z_rate)
        factorize_batch(m)
        solve_batch(m, rate)
        for i in range(len(state)):
            for r in range(len(h)):
                total[i, r] = kept * total[i, r] + weight * rate[i, r]
        for r, slot, i in np.ndindex(memory.shape):
            z_total[r, slot, i] = kept * z_total[r, slot, i] + weight * z_rate[r, slot, i]
    for i in range(len(state)):
        for r in range(len(h)):
            state[i, r] += h[r] / 6.0 * total[i, r]
    _add_memory(memory, 1.0 / 6.0, h, z_total, memory)
    correct_dry_friction(laws, geometry, sets, theta, t + h, h, before, state, memory, work, m, y)


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _settle(basis, fields, laws, geometry, theta, sets, t, u, state, memory, scratch):
    """Let dry friction bear what pulls at the states (2 d, R) that rest, where windows begin."""
    phi, x, waves, work, m, a, y, _, rate, recorded, _, z_rate, _ = scratch
    recorded[:] = memory
    for slot in range(len(laws)):
        if geometry[4][slot] >= 0:
            memory[:, slot] = 0.0
    evaluate_basis(basis, state, x, waves, phi)
    _compute_forces(fields, phi, state, u, rate, work, m, a)
    _add_force_laws(laws, geometry, sets, theta, t, state, memory, work, rate, z_rate)
    factorize_batch(m)
    settle_bristles(laws, geometry, sets, theta, t, state, recorded, memory, rate, work, m, y)


@njit(cache=True)
@no_type_check
def _make_scratch(n_functions, state, memory):
    """Work arrays of `_advance`."""
    two_d, n = state.shape
    d = two_d // 2
    forces = np.empty((n_functions, n)), np.empty((d, n)), np.empty((2, d, n)), np.empty((two_d, n))
    sums = np.empty((two_d, n)), np.zeros((two_d, n)), np.zeros((two_d, n))
    memories = np.empty_like(memory), np.zeros_like(memory), np.zeros_like(memory)
    return *forces, np.empty((d, d, n)), np.empty(n), *sums, *memories, np.empty((two_d, n))


@njit(cache=True)
@no_type_check
def _hold_diverged(state, memory, rest, reach, lost):
    """Mark rollouts that left the ``reach`` (d,) about ``rest``, and hold them there."""
    d = len(rest)
    for r in range(len(lost)):
        for i in range(d):
            if not abs(state[i, r] - rest[i]) < reach[i]:
                lost[r] = True
        if lost[r]:
            state[:d, r] = rest
            state[d:, r] = 0.0
            memory[r] = 0.0


@njit(cache=True, error_model="numpy", nogil=True)
@no_type_check
def _roll_out_side_by_side(
    jobs, basis, fields, geometry, laws, theta, memory, starts, first, length, time, u, u_of, steps, out
):
    """The rollouts ``jobs`` (R,) of a batch, in one thread: ``jobs // W`` are their sets of parameters."""
    mass, damping, potential, input_map, drag, rest = fields
    d, n_windows, reach = len(rest), starts.shape[1], DIVERGED_SCALES * basis[3]
    sets, windows = jobs // n_windows, jobs % n_windows
    state, memories = np.empty((2 * d, len(jobs))), np.empty((len(jobs), *memory.shape[2:]))
    for r in range(len(jobs)):
        state[:, r], memories[r] = starts[sets[r], windows[r]], memory[sets[r], windows[r]]
    inert = _gather(mass, sets)
    own = (
        *(inert, _differentiate(basis, inert), _gather(damping, sets)),
        *(_differentiate(basis, _gather(potential, sets)), _gather(input_map, sets)),
        _gather(drag, sets),
    )
    scratch = _make_scratch(basis[0].shape[0], state, memories)
    inputs, t, h = np.empty((3, u.shape[-1], len(jobs))), np.empty(len(jobs)), np.empty(len(jobs))
    now, lost = np.empty(len(jobs), np.int64), np.zeros(len(jobs), np.bool_)
    rubs = (geometry[4] >= 0).any()
    for frame in range(length[windows].max()):
        for r in range(len(jobs)):
            p, w = sets[r], windows[r]
            if frame < length[w]:
                out[p, w, frame] = state[:, r]
                if lost[r]:
                    out[p, w, frame, :d] = rest + reach
            # a shorter window waits for the longer ones
            now[r] = first[w] + min(frame, length[w] - 2)
            h[r] = (time[now[r] + 1] - time[now[r]]) / steps if frame < length[w] - 1 else 0.0
        for step in range(steps if h.any() else 0):
            for r in range(len(jobs)):
                t[r] = time[now[r]] + step * h[r]
                for at in range(3):
                    inputs[at, :, r] = u[u_of[sets[r]], now[r], step, at]
            if rubs and frame == 0 and step == 0:
                _settle(basis, own, laws, geometry, theta, sets, t, inputs[0], state, memories, scratch)
            _advance(basis, own, laws, geometry, theta, sets, t, h, inputs, state, memories, scratch)
            _hold_diverged(state, memories, rest, reach, lost)


@no_type_check
def roll_out_batch(
    basis, fields, laws, geometry, theta, memory, starts, first, length, time, u, u_of, steps, out
):
    """Write the states at the frames of every window, for every set of parameters, compiled and in threads.

    Rollouts are stepped side by side, so that the processor's vector instructions do several at once.

    Args:
        basis: kind, order, centre and scale of the basis, and both arrays of `Basis.derivatives`.
        fields: mass and damping (P, d, d, K), potential (P, K), input map (P, n_u, d, K), drag (P, d) and
            rest (d,); the dry friction of the simulator is among the laws.
        laws: addresses of compiled force laws (slots,).
        geometry: the directions (slots, d) in which they act and that they see, the reference inertia along
            the first (slots,), where dry friction has its presliding displacement among the parameters,
            followed by the damping of its bristles over ``sqrt(stiffness mass)``, or -1 (slots,), and the
            first slot of its contact, or -1 (slots,).
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
    geometry = *geometry, fields[-1]

    def roll_out(jobs: np.ndarray) -> None:
        _roll_out_side_by_side(
            *(jobs, basis, fields, geometry, laws, theta, memory),
            *(starts, first, length, time, u, u_of, steps, out),
        )

    run_in_threads(roll_out, starts.shape[0] * starts.shape[1], SIDE_BY_SIDE)
