"""Dry friction in rollouts: LuGre's, with bristles as stiff as one likes.

A law says how large friction is in motion. Damped bristles that bend by a presliding displacement hold what
rests; they bear a share of it between -1 and 1, which is the memory of the law's slot. The share is constant
over a step and corrected after it by an implicit rule, so that bristles may be far stiffer than a step
resolves; infinitely stiff ones are set-valued friction. Laws along one direction are one contact, whose
bristles and share are those of its first slot.

In all functions ``geometry`` and ``theta`` are those of `roll_out_batch` of
`lagsplat.diagnose.solvers.runge_kutta`, ``work`` (2 d, R) holds the conservative and the actuated forces of R
rollouts, ``m`` (d, d, R) the factor of their mass, and ``y`` (2 d, R) is scratch.

Source: Canudas de Wit, Olsson, Astrom and Lischinsky, "A new model for control of systems with friction",
1995, doi:10.1109/9.376053.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from lagsplat.diagnose.solvers.cholesky import solve_batch
from lagsplat.diagnose.solvers.force_laws import call_law, compile_force_law

PRESLIDING_SHARE = 0.003
"""Presliding displacement over the usual motion [1]; bearings give way by micrometres, and move by more."""


@compile_force_law
@no_type_check
def resist_evenly(t, s, v, spring, drive, memory, theta, d_memory):
    """Return Coulomb friction, ``-theta[0] sign(v)``."""
    return -math.copysign(theta[0], v)


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _measure_contact(slot, laws, geometry, t, state, work, y, values, nothing, r):
    """Speed along a slot's direction, friction forward and backward there, and mobility, of rollout ``r``.

    The mobility is the acceleration along the direction that a unit of friction takes away.
    """
    along, reference, contacts, rest = geometry[0][slot], geometry[2][slot], geometry[4], geometry[5]
    s, v, spring, drive, mobility, d = 0.0, 0.0, 0.0, 0.0, 0.0, len(rest)
    for i in range(d):
        s += along[i] * (state[i, r] - rest[i])
        v += along[i] * state[d + i, r]
        spring += along[i] * work[i, r] / reference
        drive += along[i] * work[d + i, r] / reference
        mobility += along[i] * y[d + i, r] * reference
    forward, backward = 0.0, 0.0
    for k in range(len(laws)):
        if contacts[k] == slot:
            forward -= call_law(laws[k], t, s, abs(v), spring, drive, nothing, values[k], nothing)
            backward += call_law(laws[k], t, s, -abs(v), spring, drive, nothing, values[k], nothing)
    return v, forward, backward, mobility


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _respond(along, m, y):
    """Write the acceleration that a unit of force along a direction gives into the second half of ``y``."""
    d = len(along)
    for i in range(d):
        y[d + i] = along[i]
    solve_batch(m, y)


@njit(cache=True, inline="always")
@no_type_check
def _choose_theta(stiffness):
    """Weight of a step's end: a half where the step resolves what happens, one where that is stiff."""
    return (1.0 + stiffness) / (2.0 + stiffness)


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _bend_bristles(share, v, begin, since, forward, backward, mobility, presliding, ratio):
    """Share of friction after a time ``since``, impulse by its change, and travel by an impulse in that time.

    ``begin`` and ``v`` are the speeds at its start, and at its end with the old share. The equation
    ``share' = (v - |v| share) / presliding`` is a quadratic one of the share at the end. The rule is the
    trapezoid's where the time resolves the bristles, and goes backwards where it does not.
    """
    old = share * (forward if share > 0.0 else backward)
    way, pull = math.copysign(1.0, v), since / presliding
    level = forward if share + pull * v > 0.0 else backward
    damping = ratio * math.sqrt(level * presliding / mobility)
    theta_v, theta_s = _choose_theta(pull * since * mobility * level), _choose_theta(pull * abs(v))
    held = theta_v * since
    far = pull * ((1.0 - theta_v) * abs(begin) + theta_v * abs(v))
    far += pull * theta_v * mobility * (held * old + damping * share) * way
    a = pull * theta_v * mobility * (held * level + damping)
    lasting = 1.0 - (1.0 - theta_s) * way * share
    b, c = 1.0 + theta_s * far + a * lasting, way * share + far * lasting
    root = math.sqrt(max(b * b - 4.0 * theta_s * a * c, 0.0))
    new = way * min(max(2.0 * c / (b + root), -1.0), 1.0)
    # a force that changes evenly moves a third as far as its impulse at once would, one that jumps a half
    return new, held * (new * level - old) + damping * (new - share), theta_v / 3.0 + 1.0 / 6.0


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def correct_dry_friction(laws, geometry, sets, theta, t, h, before, state, memory, work, m, y):
    """Correct the shares in ``memory`` (R, slots, Z), and states by that, after steps of times ``h`` (R,).

    ``before`` and ``state`` (2 d, R) are those before and after. Where the motion turned within the step,
    the correction acts since then.
    """
    along, _, inertia, bristles, contacts, rest = geometry
    d, nothing = rest.shape[0], np.empty(1)
    for slot in range(inertia.shape[0]):
        if contacts[slot] != slot:
            continue
        _respond(along[slot], m, y)
        for r in range(len(t)):
            values = theta[sets[r]]
            v, forward, backward, mobility = _measure_contact(
                *(slot, laws, geometry, t[r], state, work, y, values, nothing, r)
            )
            begin, since = 0.0, h[r]
            for i in range(d):
                begin += along[slot, i] * before[d + i, r]
            if begin * v < 0.0:
                since, begin = h[r] * abs(v) / (abs(v) + abs(begin)), 0.0
            presliding, ratio = values[slot, bristles[slot]], values[slot, bristles[slot] + 1]
            memory[r, slot, 0], impulse, travel = _bend_bristles(
                *(memory[r, slot, 0], v, begin, since, forward, backward, mobility, presliding, ratio)
            )
            for i in range(d):
                change = impulse * inertia[slot] * y[d + i, r]
                state[d + i, r] -= change
                state[i, r] -= travel * since * change


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def settle_bristles(laws, geometry, sets, theta, t, state, recorded, memory, rate, work, m, y):
    """Let dry friction bear what pulls at states (2 d, R) that rest, where windows begin.

    A recorded motion that rests does not tell how far bristles are bent. It rests, where friction can bear
    what pulls, as far as its energy is below that of bent bristles; else the shares stay as ``recorded``, the
    memory (R, slots, Z) along the recorded motion. ``rate`` (2 d, R) holds the forces without dry friction;
    what the slots so far bear is taken from it.
    """
    along, _, inertia, bristles, contacts, rest = geometry
    d, nothing = rest.shape[0], np.empty(1)
    for slot in range(inertia.shape[0]):
        if contacts[slot] != slot:
            continue
        _respond(along[slot], m, y)
        for r in range(len(t)):
            values, pull = theta[sets[r]], 0.0
            v, forward, backward, mobility = _measure_contact(
                *(slot, laws, geometry, t[r], state, work, y, values, nothing, r)
            )
            for i in range(d):
                pull += y[d + i, r] * rate[d + i, r]
            level = forward if pull > 0.0 else backward
            energy = v * v / (mobility * level * values[slot, bristles[slot]])
            share = recorded[r, slot, 0]
            if abs(pull) < mobility * level and energy < 1.0:
                share += (1.0 - energy) ** 2 * (pull / (mobility * level) - share)
            memory[r, slot, 0] = share
            borne = share * (forward if share > 0.0 else backward)
            for i in range(d):
                rate[d + i, r] -= along[slot, i] * inertia[slot] * borne


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
