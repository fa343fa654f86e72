"""The classical Runge-Kutta method: compiled rollouts of a simulator with added forces.

A batch is ``P`` sets of parameters times ``W`` windows of a recording. An added force acts along a direction
``p`` and sees a direction ``w``, which is ``p`` unless it couples coordinates: with ``s = w.(q - rest)`` its
law returns an acceleration ``f(t, s, ds/dt, ...)``, and ``p m f`` is added to the generalised forces, ``m``
being the reference inertia along ``p``. Force laws are compiled one by one and passed by their addresses, so
that a new effect compiles alone and one rollout serves all of them.

Dry friction is LuGre's: a law says how large it is in motion, and damped bristles that bend by a presliding
displacement hold what rests. They bear a share of it between -1 and 1, which is the memory of its slot. The
share is constant over a step and corrected after it by an implicit rule, so that bristles may be far stiffer
than a step resolves; infinitely stiff ones are set-valued friction.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.1; Canudas de Wit,
Olsson, Astrom and Lischinsky, "A new model for control of systems with friction", 1995,
doi:10.1109/9.376053.
"""

import math
from typing import Any, no_type_check

import numpy as np
from llvmlite import ir
from numba import cfunc, float64, njit, types
from numba.extending import intrinsic

from lagsplat.diagnose.mechanics.basis import evaluate_basis
from lagsplat.diagnose.solvers.threads import run_in_threads

VECTOR = float64[::1]
FORCE_LAW_SIGNATURE = float64(float64, float64, float64, float64, float64, VECTOR, VECTOR, VECTOR)
"""``law(t, s, v, spring, drive, memory, theta, d_memory) -> acceleration``; writes the rate of its memory."""
DIVERGED_SCALES = 1e6  # distance from rest beyond which a rollout has diverged [scale of the coordinate]
MEMORY_STEPS = 8  # midpoint steps of a force law's memory between two frames
SIDE_BY_SIDE = 64  # rollouts that one thread steps side by side [count]: their scratch fits the inner caches
MIN_PIVOT = 1e-12  # floor of a squared pivot, so that a mass matrix that is not positive gives no NaN


def compile_force_law(function: Any) -> Any:
    """Compile a force law under the signature that all of them share; a decorator.

    The compiled law has an ``address``, by which the functions of this module call it. No error can pass that
    way: a division by zero gives infinity or NaN, which ends a rollout as diverged.
    """
    return cfunc(FORCE_LAW_SIGNATURE, cache=True, error_model="numpy")(function)


@intrinsic
@no_type_check
def _call_law(typing_context, address, t, s, v, spring, drive, memory, theta, d_memory):
    """Call the force law that is compiled at an address."""

    def generate(context, builder, signature, values):
        result, *arguments = (
            context.get_value_type(each) for each in (signature.return_type, *signature.args[1:])
        )
        pointer = ir.FunctionType(result, arguments).as_pointer()
        return builder.call(builder.inttoptr(values[0], pointer), values[1:])

    return FORCE_LAW_SIGNATURE.return_type(types.int64, *FORCE_LAW_SIGNATURE.args), generate


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
    mass, mass_slope, damping, slope, input_map, dry, drag, width = fields
    d, n, dry_anywhere, varies = m.shape[0], len(a), dry.any(), mass.shape[2] > 1
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
        for r in range(n if dry_anywhere else 0):
            rate[d + i, r] -= dry[i, r] * math.tanh(state[d + i, r] / width[i])
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
    along, seen, inertia, bristles, rest = geometry
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
            if bristles[slot] >= 0:
                share, v = abs(z[0]), math.copysign(v, z[0])
            f = share * _call_law(
                laws[slot], t[r], s, v, spring / reference, drive / reference, z, values, z_rate
            )
            for i in range(d):
                rate[d + i, r] += along[slot, i] * reference * f


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _factorize(a):
    """Overwrite the lower triangle of ``a`` (d, d, R) with its Cholesky factor, the diagonal inverted."""
    d, n = a.shape[0], a.shape[2]
    for j in range(d):
        for k in range(j):
            for i in range(j, d):
                for r in range(n):
                    a[i, j, r] -= a[i, k, r] * a[j, k, r]
        for r in range(n):
            a[j, j, r] = 1.0 / math.sqrt(max(a[j, j, r], MIN_PIVOT))
        for i in range(j + 1, d):
            for r in range(n):
                a[i, j, r] *= a[j, j, r]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _solve(a, b):
    """Replace the second half of ``b`` (2 d, R) by the solution for the factor ``a`` (d, d, R)."""
    d, n = a.shape[0], a.shape[2]
    for i in range(d):
        for k in range(i):
            for r in range(n):
                b[d + i, r] -= a[i, k, r] * b[d + k, r]
        for r in range(n):
            b[d + i, r] *= a[i, i, r]
    for i in range(d - 1, -1, -1):
        for k in range(i + 1, d):
            for r in range(n):
                b[d + i, r] -= a[k, i, r] * b[d + k, r]
        for r in range(n):
            b[d + i, r] *= a[i, i, r]


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
        _factorize(m)
        _solve(m, rate)
        for i in range(len(state)):
            for r in range(len(h)):
                total[i, r] = kept * total[i, r] + weight * rate[i, r]
        for r, slot, i in np.ndindex(memory.shape):
            z_total[r, slot, i] = kept * z_total[r, slot, i] + weight * z_rate[r, slot, i]
    for i in range(len(state)):
        for r in range(len(h)):
            state[i, r] += h[r] / 6.0 * total[i, r]
    _add_memory(memory, 1.0 / 6.0, h, z_total, memory)
    _correct_dry_friction(laws, geometry, sets, theta, t + h, h, state, memory, scratch)


@njit(cache=True, inline="always")
@no_type_check
def _choose_theta(stiffness):
    """Weight of a step's end: a half where the step resolves what happens, one where that is stiff."""
    return (1.0 + stiffness) / (2.0 + stiffness)


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _correct_dry_friction(laws, geometry, sets, theta, t, h, state, memory, scratch):
    """Correct the shares of dry friction after a step of times ``h`` (R,), and the states (2 d, R) by that.

    Where the motion turned within the step, the correction acts since then. ``scratch`` holds the state
    before the step, and the forces and the factor of the mass at its last stage.
    """
    _, _, _, work, m, _, y, _, _, _, _, nothing, before = scratch
    along, _, inertia, bristles, rest = geometry
    d = rest.shape[0]
    for slot in range(inertia.shape[0]):
        if bristles[slot] < 0:
            continue
        reference = inertia[slot]
        for i in range(d):
            y[d + i] = along[slot, i]
        _solve(m, y)
        for r in range(len(t)):
            s, v, spring, drive, mobility, begin = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(d):
                s += along[slot, i] * (state[i, r] - rest[i])
                v += along[slot, i] * state[d + i, r]
                begin += along[slot, i] * before[d + i, r]
                spring += along[slot, i] * work[i, r] / reference
                drive += along[slot, i] * work[d + i, r] / reference
                mobility += along[slot, i] * y[d + i, r] * reference
            values, share, z_rate = theta[sets[r], slot], memory[r, slot, 0], nothing[r, slot]
            forward = -_call_law(laws[slot], t[r], s, abs(v), spring, drive, memory[r, slot], values, z_rate)
            backward = _call_law(laws[slot], t[r], s, -abs(v), spring, drive, memory[r, slot], values, z_rate)
            since = h[r]
            if begin * v < 0.0:
                since, begin = h[r] * abs(v) / (abs(v) + abs(begin)), 0.0
            old = share * (forward if share > 0.0 else backward)
            presliding, ratio = values[bristles[slot]], values[bristles[slot] + 1]
            way, pull = math.copysign(1.0, v), since / presliding
            level = forward if share + pull * v > 0.0 else backward
            damping = ratio * math.sqrt(level * presliding / mobility)
            # share' = (v - |v| share) / presliding: a quadratic equation of the share at the end; the rule is
            # the trapezoid's where the step resolves the bristles, and goes backwards where it does not
            theta_v, theta_s = _choose_theta(pull * since * mobility * level), _choose_theta(pull * abs(v))
            held = theta_v * since
            far = pull * ((1.0 - theta_v) * abs(begin) + theta_v * abs(v))
            far += pull * theta_v * mobility * (held * old + damping * share) * way
            a = pull * theta_v * mobility * (held * level + damping)
            rest_share = 1.0 - (1.0 - theta_s) * way * share
            b, c = 1.0 + theta_s * far + a * rest_share, way * share + far * rest_share
            root = math.sqrt(max(b * b - 4.0 * theta_s * a * c, 0.0))
            new = way * min(max(2.0 * c / (b + root), -1.0), 1.0)
            impulse = (held * (new * level - old) + damping * (new - share)) * reference
            memory[r, slot, 0] = new
            for i in range(d):
                state[d + i, r] -= impulse * y[d + i, r]
                state[i, r] -= (theta_v / 3.0 + 1.0 / 6.0) * since * impulse * y[d + i, r]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _settle_bristles(basis, fields, laws, geometry, theta, sets, t, u, state, memory, scratch):
    """Let dry friction bear what pulls at states (2 d, R) that rest, where windows begin.

    A recorded motion that rests does not tell how far bristles are bent. It rests, where friction can bear
    what pulls, as far as its energy is below that of bent bristles.
    """
    phi, x, waves, work, m, a, y, _, rate, _, _, z_rate, _ = scratch
    along, _, inertia, bristles, rest = geometry
    d = rest.shape[0]
    evaluate_basis(basis, state, x, waves, phi)
    for slot in range(inertia.shape[0]):
        if bristles[slot] < 0:
            continue
        recorded = memory[:, slot, 0].copy()
        memory[:, slot, 0] = 0.0
        _compute_forces(fields, phi, state, u, rate, work, m, a)
        _add_force_laws(laws, geometry, sets, theta, t, state, memory, work, rate, z_rate)
        _factorize(m)
        for i in range(d):
            y[d + i] = along[slot, i]
        _solve(m, y)
        for r in range(len(t)):
            s, v, pull, spring, drive, mobility = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(d):
                s += along[slot, i] * (state[i, r] - rest[i])
                v += along[slot, i] * state[d + i, r]
                pull += y[d + i, r] * rate[d + i, r]
                spring += along[slot, i] * work[i, r] / inertia[slot]
                drive += along[slot, i] * work[d + i, r] / inertia[slot]
                mobility += along[slot, i] * y[d + i, r] * inertia[slot]
            values, towards = theta[sets[r], slot], math.copysign(abs(v), pull)
            most = mobility * abs(
                _call_law(
                    laws[slot], t[r], s, towards, spring, drive, memory[r, slot], values, z_rate[r, slot]
                )
            )
            energy = v * v / (most * values[bristles[slot]])
            memory[r, slot, 0] = recorded[r]
            if abs(pull) < most and energy < 1.0:
                memory[r, slot, 0] += (1.0 - energy) ** 2 * (pull / most - recorded[r])


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
    mass, damping, potential, input_map, dry, drag, width, rest = fields
    d, n_windows, reach = len(rest), starts.shape[1], DIVERGED_SCALES * basis[3]
    sets, windows = jobs // n_windows, jobs % n_windows
    state, memories = np.empty((2 * d, len(jobs))), np.empty((len(jobs), *memory.shape[2:]))
    for r in range(len(jobs)):
        state[:, r], memories[r] = starts[sets[r], windows[r]], memory[sets[r], windows[r]]
    inert = _gather(mass, sets)
    own = (
        *(inert, _differentiate(basis, inert), _gather(damping, sets)),
        *(_differentiate(basis, _gather(potential, sets)), _gather(input_map, sets)),
        *(_gather(dry, sets), _gather(drag, sets), width),
    )
    scratch = _make_scratch(basis[0].shape[0], state, memories)
    inputs, t, h = np.empty((3, u.shape[-1], len(jobs))), np.empty(len(jobs)), np.empty(len(jobs))
    now, lost = np.empty(len(jobs), np.int64), np.zeros(len(jobs), np.bool_)
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
            if frame == 0 and step == 0:
                _settle_bristles(
                    basis, own, laws, geometry, theta, sets, t, inputs[0], state, memories, scratch
                )
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
        fields: mass and damping (P, d, d, K), potential (P, K), input map (P, n_u, d, K), dry friction and
            drag (P, d), speed (d,) below which dry friction is linear, and rest (d,).
        laws: addresses of compiled force laws (slots,).
        geometry: the directions (slots, d) in which they act and that they see, the reference inertia along
            the first (slots,), and where dry friction has its presliding displacement among the parameters,
            followed by the damping of its bristles over ``sqrt(stiffness mass)``, or -1 (slots,).
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


@njit(cache=True)
@no_type_check
def integrate_memory(law, theta, time, motion, clips, begin, out):
    """Write a force law's memory along a recorded motion by the explicit midpoint rule, compiled.

    Args:
        law, theta: address of the compiled law, and its parameters (P, n).
        time: times of the frames (N,) [s].
        motion: along the law's direction, the coordinate, its rate, and the simulator's conservative and
            actuated acceleration (N, 4); linear between frames.
        clips: first frame and end of each clip (C, 2).
        begin: memory where each clip starts (P, C, Z).
        out: memory at the frames (P, N, Z), written.
    """
    n_sets, _, n_z = out.shape
    rate, y, z, x = np.zeros(n_z), np.zeros(n_z), np.zeros(n_z), np.zeros(4)
    for p in range(n_sets):
        for clip in range(clips.shape[0]):
            z[:] = begin[p, clip]
            for n in range(clips[clip, 0], clips[clip, 1]):
                out[p, n] = z
                if n + 1 == clips[clip, 1]:
                    break
                h = (time[n + 1] - time[n]) / MEMORY_STEPS
                for step in range(MEMORY_STEPS):
                    for half in range(2):
                        share = (step + 0.5 * half) / MEMORY_STEPS
                        for i in range(n_z):
                            y[i] = z[i] + 0.5 * h * rate[i] if half == 1 else z[i]
                        for i in range(4):
                            x[i] = motion[n, i] + share * (motion[n + 1, i] - motion[n, i])
                        t = time[n] + share * MEMORY_STEPS * h
                        _call_law(law, t, x[0], x[1], x[2], x[3], y, theta[p], rate)
                    for i in range(n_z):
                        z[i] += h * rate[i]


@njit(cache=True)
@no_type_check
def integrate_presliding(displacement, s, clips, out):
    """Write the share of dry friction along a recorded motion that is linear between frames, compiled.

    Args:
        displacement: presliding displacements (P,).
        s: coordinate at the frames (N,).
        clips: first frame and end of each clip (C, 2).
        out: shares at the frames (P, N), written; where a clip begins they are full, by the way it goes.
    """
    for p in range(len(displacement)):
        for clip in range(clips.shape[0]):
            first, end = clips[clip]
            out[p, first] = np.sign(s[min(first + 1, end - 1)] - s[first])
            for n in range(first + 1, end):
                far = (s[n] - s[n - 1]) / displacement[p]
                way = math.copysign(1.0, far)
                out[p, n] = way - (way - out[p, n - 1]) * math.exp(-abs(far))
