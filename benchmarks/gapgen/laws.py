"""Constitutive laws of the withheld effects, as they enter the equations of motion.

Every law is another one than a catalogue of textbook terms would hold where physics offers one: friction is
set-valued or a bristle model, hysteresis a Maxwell-slip chain, contact Hunt and Crossley's, creep two
branches, hardening a hyperbolic sine. Magnitudes are accelerations: a force divided by the inertia at rest.

A row of ``which`` (n_e, 4) is law, coordinate, first internal state, input; a row of ``how`` (n_e, 16) its
numbers.
"""

import numpy as np
from numba import njit

VISCOUS, SCALED_POTENTIAL, SPRING, INERTIA, CONSTANT, TILT, HARDENING = 1, 2, 3, 4, 5, 6, 7
FRICTION, BRISTLE, DRAG, SLIP_CHAIN, CREEP, FREE_PLAY, STOP = 8, 9, 10, 11, 12, 13, 14
PUSH, PERIODIC, DRIFT_POTENTIAL, DRIFT_FORCE, ABSORBER = 15, 16, 17, 18, 19
COGGING, PARAMETRIC, LOCAL_DAMPING, BUMP, ONE_WAY, SWITCH, RUMBLE, INPUT_STIFFNESS, SELF_EXCITED = (
    30,
    31,
    32,
    33,
    34,
    35,
    36,
    37,
    38,
)
PAYLOAD, MASSES, SERVO, MOTOR, TEETH, MESH, LIP_SEAL, COUPLING, BASE = 40, 41, 42, 43, 44, 45, 46, 47, 48
FRACTIONAL, BELT, SPEED_SOFTENING = 50, 51, 52
IN_MECHANISM = (PAYLOAD, MASSES)
"""Laws that are other masses of the mechanism itself."""
WIDTH = 16
BRANCHES = 5
SLIDERS = 5


def n_states(law: int) -> int:
    """Number of internal states of a law."""
    known = {BRISTLE: 1, SLIP_CHAIN: SLIDERS, CREEP: 2, ABSORBER: 2, MOTOR: 1, FRACTIONAL: BRANCHES}
    return known.get(law, 0)


@njit(cache=True)
def friction_level(th, v, load):
    """Friction of th = (coulomb, static, velocity, load factor, load reference) at a speed and load."""
    level = th[0] + (th[1] - th[0]) / (1.0 + (v / th[2]) ** 2)
    return level * (1.0 + th[3] * abs(load) / th[4])


@njit(cache=True)
def soft_dead_band(x, half, width):
    """A dead band of the given half width whose corners are rounded over ``width``."""
    up, down = (x - half) / width, (-x - half) / width
    positive = up if up > 30.0 else np.log1p(np.exp(up))
    negative = down if down > 30.0 else np.log1p(np.exp(down))
    return width * (positive - negative)


@njit(cache=True)
def slider_limit(th, k):
    """Deflection at which the k-th slider of a chain with mean th[1] yields."""
    return th[1] * (0.3 + 0.35 * k)


@njit(cache=True)
def exogenous(law, th, t):
    """Acceleration that depends on time alone."""
    if law == PUSH:
        total = 0.0
        for k in range(3):
            phase = (t - th[3 * k]) / max(th[3 * k + 1], 1e-9)
            if 0.0 < phase < 1.0:
                total += th[3 * k + 2] * np.sin(np.pi * phase)
        return total
    if law == PERIODIC:
        return th[0] * (np.sin(th[1] * t + th[2]) + th[3] * np.sin(2.0 * th[1] * t + 2.0 * th[2] + 0.7))
    if law == DRIFT_FORCE:
        return th[0] * th[1] * (1.0 - np.exp(-t / th[1]))
    total = 0.0
    for k in range(1, 10):
        total += np.sin(th[1] * (0.35 + 0.171 * k + 0.023 * k * k) * t + k * k * th[2] + k)
    return th[0] * total / 2.1


@njit(cache=True)
def memory(law, th, z, dz, at, q, v, load):
    """Acceleration of the laws with internal states ``z[at:]``; fills their rates."""
    if law == BRISTLE:
        level = friction_level(th, v, load)
        stiffness = max(th[0], th[1]) / th[6]
        dz[at] = v - abs(v) * z[at] * stiffness / max(level, 1e-12)
        return -stiffness * z[at] - th[7] * dz[at]
    if law == SLIP_CHAIN:
        total, norm = 0.0, 0.0
        for k in range(SLIDERS):
            limit = slider_limit(th, k)
            dz[at + k] = v
            total += min(max(z[at + k], -limit), limit)
            norm += limit
        return -th[0] * total / norm
    if law == FRACTIONAL:
        # a spring-pot as a sum of Maxwell branches, each twice as weak and th[2] times as slow as the last
        total = 0.0
        for k in range(BRANCHES):
            late = q - z[at + k]
            dz[at + k] = late / (th[1] * th[2] ** k)
            total += late * th[2] ** (-th[3] * k)
        return -th[0] * total
    if law == CREEP:
        dz[at] = (q - z[at]) / th[1]
        dz[at + 1] = (q - z[at + 1]) / th[2]
        return -th[0] * (th[3] * (q - z[at]) + (1.0 - th[3]) * (q - z[at + 1]))
    stretch, rate = z[at] - q, z[at + 1] - v
    pull = th[0] ** 2 * stretch * (1.0 + th[3] * stretch * stretch) + 2.0 * th[2] * th[0] * rate
    dz[at] = z[at + 1]
    dz[at + 1] = -pull
    return th[1] * pull


@njit(cache=True)
def conservative(law, th, q):
    """Acceleration of the laws that depend on the coordinate alone."""
    if law == SPRING:
        return -th[0] * q
    if law == CONSTANT:
        return th[0]
    if law == TILT:
        return -th[0] * (np.sin(q + th[1]) - np.sin(q))
    if law == HARDENING:
        x = q / th[1]
        shape = 6.0 * (np.sinh(x) - x) if th[0] > 0.0 else 3.0 * (x - np.arctan(x))
        return -th[0] * th[1] ** 3 * shape
    if law == FREE_PLAY:
        return th[3] * th[0] * (q - soft_dead_band(q, th[1], th[2]))
    if law == COGGING:
        return th[0] * np.sin(th[1] * q + th[2])
    if law == TEETH:
        angle = th[1] * q + th[2]
        return th[0] * (np.sin(angle) + th[3] * np.sin(2.0 * angle))
    x = (q - th[1]) / th[2]
    return th[0] * x * np.exp(0.5 - 0.5 * x * x)


@njit(cache=True)
def resistive(law, th, t, q, v):
    """Acceleration of the remaining laws of coordinate, speed and time."""
    if law == VISCOUS:
        return -th[0] * v * (abs(v) / th[2] + 1e-9) ** (th[1] - 1.0)
    if law == DRAG:
        return -th[0] * th[2] * v * (abs(v) / th[2] + 1e-12) ** (th[1] - 1.0)
    if law == STOP:
        depth = th[0] * (q - th[1])
        if depth <= 0.0:
            return 0.0
        return -th[0] * max(th[2] * depth**1.5 * (1.0 + th[3] * th[0] * v), 0.0)
    if law == PARAMETRIC:
        return -th[0] * th[3] * np.cos(th[1] * t + th[2]) * q
    if law == LOCAL_DAMPING:
        return -th[0] * v * np.exp(-(((q - th[1]) / th[2]) ** 2))
    if law == ONE_WAY:
        return -th[0] * max(v * th[1], 0.0) * th[1]
    if law == MESH:
        # a wave with flanks, as of teeth that carry in turn
        return -th[0] * th[3] * np.tanh(th[4] * np.cos(th[1] * t + th[2])) / np.tanh(th[4]) * q
    if law == LIP_SEAL:
        level = th[0] if v > 0.0 else th[1]
        return -level * v / (abs(v) + th[2])
    if law == BELT:
        # friction on a belt that moves, falling with the speed of slip
        slip = (v - th[1]) / th[2]
        return -th[0] * np.tanh(8.0 * slip) / (1.0 + abs(slip))
    if law == SPEED_SOFTENING:
        return th[0] * q * v * v / (v * v + th[1] * th[1])
    if law == SELF_EXCITED:
        return th[0] * v * (1.0 - (q / th[1]) ** 2)
    return -(th[0] * q + th[2] * v) if t > th[1] else 0.0


@njit(cache=True)
def coupling(th, q, v):
    """Acceleration by the position or the speed of another coordinate, the former with a limit."""
    return th[0] * v if th[2] > 0.0 else th[0] * th[3] * np.tanh(q / th[3])


@njit(cache=True)
def servo(th, target, q, v):
    """Acceleration by the gains of a position controller that differ from the nominal ones."""
    return th[0] * (target - q) - th[1] * v


@njit(cache=True)
def motor(th, z, dz, at, drive, v):
    """What a motor at its limits adds to the acceleration ``drive``.

    th = (stall, no-load speed, sag, its time): the supply sags by the power that is drawn, ``z[at]``.
    """
    full = th[0] * max(1.0 - th[2] * z[at], 0.2)
    most = full * min(max(1.0 - v / th[1], 0.0), 1.0)
    least = -full * min(max(1.0 + v / th[1], 0.0), 1.0)
    given = min(max(drive, least), most)
    dz[at] = (max(given * v, 0.0) / (0.25 * th[0] * th[1]) - z[at]) / th[3]
    return given - drive


@njit(cache=True)
def is_exogenous(law):
    """Whether the law depends on time alone."""
    return law in (PUSH, PERIODIC, DRIFT_FORCE, RUMBLE)


@njit(cache=True)
def is_memory(law):
    """Whether the law has internal states."""
    return law in (BRISTLE, SLIP_CHAIN, CREEP, ABSORBER, FRACTIONAL)


@njit(cache=True)
def is_conservative(law):
    """Whether the law is a function of the coordinate alone."""
    return law in (SPRING, CONSTANT, TILT, HARDENING, FREE_PLAY, COGGING, BUMP, TEETH)
