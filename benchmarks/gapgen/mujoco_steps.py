"""MuJoCo's step in a compiled loop that applies the laws of the withheld effects before each."""

import ctypes
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numba import njit, types
from numba.experimental import function_type  # noqa: F401  makes such functions known to the compiler

from benchmarks.gapgen.integrate import yield_sliders
from benchmarks.gapgen.laws import (
    BASE,
    COUPLING,
    DRIFT_POTENTIAL,
    FRICTION,
    INPUT_STIFFNESS,
    MOTOR,
    PERIODIC,
    conservative,
    coupling,
    exogenous,
    friction_level,
    is_conservative,
    is_exogenous,
    is_memory,
    memory,
    motor,
    resistive,
)

# steps of internal states in one of MuJoCo's
INNER = 4
warnings.filterwarnings("ignore", message="First-class function type feature is experimental")


class _Function(types.WrapperAddressProtocol):
    """A function ``void f(const mjModel*, mjData*)`` of MuJoCo's library by its name."""

    def __init__(self, name: str) -> None:
        (path,) = Path(mujoco.__file__).parent.glob("*mujoco*.[0-9].[0-9].[0-9]*")
        self.address = ctypes.cast(getattr(ctypes.CDLL(str(path)), name), ctypes.c_void_p).value

    def __wrapper_address__(self) -> int:
        return self.address

    def signature(self) -> Any:
        return types.void(types.intp, types.intp)


@cache
def stepping_functions() -> tuple[Any, Any]:
    """``mj_step`` and ``mj_forward`` as a compiled loop calls them."""
    return _Function("mj_step"), _Function("mj_forward")


@njit(cache=True)
def _force(law, th, t, x, dx, at, q, v, load, u):
    """Acceleration of one law; fills the rates of its internal states. Of a motor ``u`` is the drive."""
    if law == MOTOR:
        return motor(th, x, dx, at, u, v)
    if is_exogenous(law):
        return exogenous(law, th, t)
    if is_memory(law):
        return memory(law, th, x, dx, at, q, v, load)
    if is_conservative(law):
        return conservative(law, th, q)
    if law == INPUT_STIFFNESS:
        return -th[0] * u * q
    return resistive(law, th, t, q, v)


@njit(cache=True)
def _remember(law, th, t, h, x, dx, at, q, v, a, load, u):
    """Mean acceleration of a law over a step, through which its internal states go by the midpoint rule."""
    small, total = h / INNER, 0.0
    begun = np.empty(len(x) - at)
    for s in range(INNER):
        now, half = s * small, (s + 0.5) * small
        begun[:] = x[at:]
        dx[at:] = 0.0
        _force(law, th, t, x, dx, at, q + v * now + 0.5 * a * now * now, v + a * now, load, u)
        for k in range(len(begun)):
            x[at + k] = begun[k] + 0.5 * small * dx[at + k]
        total += _force(law, th, t, x, dx, at, q + v * half + 0.5 * a * half * half, v + a * half, load, u)
        for k in range(len(begun)):
            x[at + k] = begun[k] + small * dx[at + k]
    return total / INNER


@njit(cache=True)
def _escapes(fields, scales):
    """Whether the motion is about to leave every bound; MuJoCo would say so in a file."""
    qpos, qacc, applied = fields[0], fields[2], fields[4]
    inertia, _, bound = scales
    for i in range(len(qpos)):
        inside = abs(qpos[i]) < bound[i] and abs(qacc[i]) < 1e5 * bound[i]
        if not (inside and abs(applied[i]) < 1e5 * bound[i] * inertia[i]):
            return True
    return False


@njit(cache=True)
def _apply(fields, scales, which, how, t, h, x, dx, u):
    """Forces of all laws at the middle ``t`` of a step ``h``; internal states ``x[2 d:]`` go through it."""
    qpos, qvel, qacc, _, applied, _, bias, spring, push, loss, stiffness, gravity = fields
    inertia, at_rest, _ = scales
    d = len(qpos)
    applied[:] = 0.0
    for e in range(which.shape[0]):
        law, i, at, th = which[e, 0], which[e, 1], 2 * d + which[e, 2], how[e]
        load = (bias[i] - spring[i] + push[i]) / inertia[i]
        q = qpos[i] + 0.5 * h * qvel[i] + 0.125 * h * h * qacc[i]
        v = qvel[i] + 0.5 * h * qacc[i]
        if law == FRICTION:
            loss[i] += friction_level(th, v, load) * inertia[i]
        elif law == DRIFT_POTENTIAL:
            stiffness[i] += at_rest[i] * th[0] * th[1] * (1.0 - np.exp(-t / th[1]))
        elif law == BASE:
            # what a base that moves along x does is done by a field of force against it
            gravity[0] -= exogenous(PERIODIC, th, t)
        elif law == COUPLING:
            k = int(th[1])
            there = qpos[k] + 0.5 * h * qvel[k] + 0.125 * h * h * qacc[k]
            applied[i] += inertia[i] * coupling(th, there, qvel[k] + 0.5 * h * qacc[k])
        elif is_memory(law) or law == MOTOR:
            drive = push[i] / inertia[i]
            extra = _remember(law, th, t, h, x, dx, at, qpos[i], qvel[i], qacc[i], load, drive)
            applied[i] += inertia[i] * extra
        else:
            applied[i] += inertia[i] * _force(law, th, t, x, dx, at, q, v, load, u[which[e, 3]])


@njit(cache=True)
def run_mujoco(step, forward, where, fields, scales, which, how, x0, t0, dt, n, n_sub, u):
    """States (n, n_x) at ``t0 + k dt`` from ``x0``; ``u`` (2 (n - 1) n_sub + 1, n_u) at every half step.

    ``where`` are the addresses of model and data, ``fields`` views of what a step reads and writes,
    ``scales`` inertia and stiffness at rest and the bound (d,) of the coordinates, beyond which states are
    infinite.
    """
    qpos, qvel, _, warm, applied, ctrl, _, _, _, loss, stiffness, gravity = fields
    d = len(qpos)
    h = dt / n_sub
    x = x0.copy()
    dx = np.zeros(len(x))
    out = np.full((n, len(x)), np.inf)
    out[0] = x
    own_loss, own_stiffness = loss.copy(), stiffness.copy()
    qpos[:] = x[:d]
    qvel[:] = x[d : 2 * d]
    warm[:] = 0.0
    applied[:] = 0.0
    ctrl[:] = u[0]
    forward(where[0], where[1])
    for s in range((n - 1) * n_sub):
        ctrl[:] = u[2 * s + 1]
        loss[:] = own_loss
        stiffness[:] = own_stiffness
        gravity[0] = 0.0
        _apply(fields, scales, which, how, t0 + (s + 0.5) * h, h, x, dx, ctrl)
        if _escapes(fields, scales):
            break
        step(where[0], where[1])
        yield_sliders(which, how, x, d)
        if (s + 1) % n_sub == 0:
            x[:d] = qpos
            x[d : 2 * d] = qvel
            out[(s + 1) // n_sub] = x
    loss[:] = own_loss
    stiffness[:] = own_stiffness
    gravity[0] = 0.0
    return out
