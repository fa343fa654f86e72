"""Motion by the classical Runge-Kutta rule in fine steps, set-valued friction by symmetric splitting.

The state is ``x = (q, v, z)`` with the internal states of the laws last. Inputs are given at every half step.
"""

import numpy as np
from numba import njit

from benchmarks.gapgen.bases import base_pull
from benchmarks.gapgen.laws import (
    BASE,
    COUPLING,
    DRIFT_POTENTIAL,
    FRICTION,
    INERTIA,
    INPUT_STIFFNESS,
    MASSES,
    MOTOR,
    PAYLOAD,
    PERIODIC,
    SCALED_POTENTIAL,
    SERVO,
    SLIDERS,
    SLIP_CHAIN,
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
    servo,
    slider_limit,
)
from benchmarks.gapgen.mechanisms import terms


@njit(cache=True)
def _solve(a, b, n):
    """Solve a symmetric positive definite system in place; the solution replaces ``b``."""
    for j in range(n):
        for k in range(j):
            a[j, j] -= a[j, k] * a[j, k]
        a[j, j] = np.sqrt(max(a[j, j], 1e-30))
        for i in range(j + 1, n):
            for k in range(j):
                a[i, j] -= a[i, k] * a[j, k]
            a[i, j] /= a[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= a[i, k] * b[k]
        b[i] /= a[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= a[k, i] * b[k]
        b[i] /= a[i, i]


@njit(cache=True)
def _rates(kind, p, b, inertia, which, how, t, x, u, dx, work):
    """Rates ``dx`` of the state; ``work`` holds mass (d, d) and load (d,) for the friction split."""
    d = b.shape[0]
    q, v = x[:d], x[d : 2 * d]
    mass, bias, drag, grad, load = work
    terms(kind, p, q, v, mass, bias, drag, grad)
    for e in range(which.shape[0]):
        law, i, th = which[e, 0], which[e, 1], how[e]
        if law == SCALED_POTENTIAL:
            grad[i] *= th[0]
        elif law == DRIFT_POTENTIAL:
            grad[i] *= 1.0 + th[0] * th[1] * (1.0 - np.exp(-t / th[1]))
        elif law == INERTIA:
            mass[i, i] += th[0] * inertia[i]
    for i in range(d):
        push = 0.0
        for j in range(u.shape[0]):
            push += b[i, j] * u[j]
        dx[i] = v[i]
        dx[d + i] = push - grad[i] - drag[i] - bias[i]
        # what a gear carries between the drive on one side and the rest on the other
        load[i] = (grad[i] + push) / inertia[i]
    for e in range(which.shape[0]):
        law, i, at, th = which[e, 0], which[e, 1], which[e, 2], how[e]
        if is_exogenous(law):
            extra = exogenous(law, th, t)
        elif is_memory(law):
            extra = memory(law, th, x, dx, 2 * d + at, q[i], v[i], load[i])
        elif is_conservative(law):
            extra = conservative(law, th, q[i])
        elif law == INPUT_STIFFNESS:
            extra = -th[0] * u[which[e, 3]] * q[i]
        elif law == COUPLING:
            extra = coupling(th, q[int(th[1])], v[int(th[1])])
        elif law == SERVO:
            extra = servo(th, u[which[e, 3]], q[i], v[i])
        elif law == MOTOR:
            push = 0.0
            for j in range(u.shape[0]):
                push += b[i, j] * u[j]
            extra = motor(th, x, dx, 2 * d + at, push / inertia[i], v[i])
        elif law == BASE:
            base_pull(kind, p, q, mass, load)
            shake = exogenous(PERIODIC, th, t)
            for j in range(d):
                dx[d + j] -= load[j] * shake
            extra = 0.0
        elif law in (FRICTION, SCALED_POTENTIAL, DRIFT_POTENTIAL, INERTIA, PAYLOAD, MASSES):
            extra = 0.0
        else:
            extra = resistive(law, th, t, q[i], v[i])
        dx[d + i] += inertia[i] * extra
    _solve(mass, dx[d : 2 * d], d)


@njit(cache=True)
def _rub(kind, p, b, inertia, which, how, t, x, u, dx, work, h):
    """Set-valued friction over a time ``h``: an impulse within its limit that takes speed away."""
    d = b.shape[0]
    for e in range(which.shape[0]):
        if which[e, 0] != FRICTION:
            continue
        i, th = which[e, 1], how[e]
        _rates(kind, p, b, inertia, which, how, t, x, u, dx, work)
        unit = np.zeros(d)
        unit[i] = 1.0
        mass = work[0].copy()
        terms(kind, p, x[:d], x[d : 2 * d], mass, work[1], work[2], work[3])
        for other in range(which.shape[0]):
            if which[other, 0] == INERTIA:
                mass[which[other, 1], which[other, 1]] += how[other, 0] * inertia[which[other, 1]]
        _solve(mass, unit, d)
        v = x[d + i]
        most = friction_level(th, v, work[4][i]) * inertia[i] * h
        impulse = -v / unit[i]
        impulse = min(max(impulse, -most), most)
        for j in range(d):
            x[d + j] += unit[j] * impulse


@njit(cache=True)
def yield_sliders(which, how, x, d):
    """Let the sliders of every slip chain in the state ``x`` give way at their limits."""
    for e in range(which.shape[0]):
        if which[e, 0] == SLIP_CHAIN:
            for k in range(SLIDERS):
                limit = slider_limit(how[e], k)
                at = 2 * d + which[e, 2] + k
                x[at] = min(max(x[at], -limit), limit)


@njit(cache=True)
def run(kind, p, b, inertia, which, how, x0, t0, dt, n, n_sub, u):
    """States (n, n_x) at ``t0 + k dt`` from ``x0``; ``u`` (2 (n - 1) n_sub + 1, n_u) at every half step."""
    d, n_x = b.shape[0], len(x0)
    h = dt / n_sub
    out = np.empty((n, n_x))
    x = x0.copy()
    out[0] = x
    k1, k2, k3, k4, y = np.zeros(n_x), np.zeros(n_x), np.zeros(n_x), np.zeros(n_x), np.zeros(n_x)
    work = (np.zeros((d, d)), np.zeros(d), np.zeros(d), np.zeros(d), np.zeros(d))
    rubs, slips = False, False
    for e in range(which.shape[0]):
        rubs = rubs or which[e, 0] == FRICTION
        slips = slips or which[e, 0] == SLIP_CHAIN
    for s in range((n - 1) * n_sub):
        t = t0 + s * h
        if rubs:
            _rub(kind, p, b, inertia, which, how, t, x, u[2 * s], k1, work, 0.5 * h)
        _rates(kind, p, b, inertia, which, how, t, x, u[2 * s], k1, work)
        for i in range(n_x):
            y[i] = x[i] + 0.5 * h * k1[i]
        _rates(kind, p, b, inertia, which, how, t + 0.5 * h, y, u[2 * s + 1], k2, work)
        for i in range(n_x):
            y[i] = x[i] + 0.5 * h * k2[i]
        _rates(kind, p, b, inertia, which, how, t + 0.5 * h, y, u[2 * s + 1], k3, work)
        for i in range(n_x):
            y[i] = x[i] + h * k3[i]
        _rates(kind, p, b, inertia, which, how, t + h, y, u[2 * s + 2], k4, work)
        for i in range(n_x):
            x[i] += h * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]) / 6.0
        if rubs:
            _rub(kind, p, b, inertia, which, how, t + h, x, u[2 * s + 2], k1, work, 0.5 * h)
        if slips:
            yield_sliders(which, how, x, d)
        if (s + 1) % n_sub == 0:
            out[(s + 1) // n_sub] = x
    return out


@njit(cache=True)
def start_state(kind, p, b, inertia, which, how, x0, t0, dt, n_sub, u, y):
    """State whose motion fits the samples ``y`` (m, d) best: Gauss-Newton steps from ``x0``.

    Internal states are kept as ``x0`` has them.
    """
    m, d = y.shape
    x = x0.copy()
    best, least = x0.copy(), np.inf
    jacobian = np.zeros((m * d, 2 * d))
    residual = np.zeros(m * d)
    for k in range(4):
        base = run(kind, p, b, inertia, which, how, x, t0, dt, m, n_sub, u)
        residual[:] = (y - base[:, :d]).ravel()
        cost = (residual**2).sum()
        if not cost < least:
            # back half way: the step crossed a corner of a law
            x[:] = 0.5 * (x + best)
            continue
        best[:], least = x, cost
        if k == 3:
            break
        for j in range(2 * d):
            step = 1e-5 * (1.0 + abs(x[j]))
            moved = x.copy()
            moved[j] += step
            there = run(kind, p, b, inertia, which, how, moved, t0, dt, m, n_sub, u)
            jacobian[:, j] = ((there[:, :d] - base[:, :d]) / step).ravel()
        normal = jacobian.T @ jacobian
        right = jacobian.T @ residual
        # a mechanism that sticks does not feel its first speed
        ridge = 1e-5 * np.trace(normal) * min(dt * m, 1.0) ** 2
        for j in range(2 * d):
            normal[j, j] += ridge
        _solve(normal, right, 2 * d)
        x[: 2 * d] += right
    return best


@njit(cache=True)
def forecasts(kind, p, b, inertia, which, how, x0, starts, t0, dt, burn, n, n_sub, u, y):
    """Forecasts (n_blocks, n, d) from states estimated on the first ``burn`` samples of each block.

    ``x0`` (n_blocks, n_x) are first guesses with the internal states, ``starts`` the first samples in the
    clip.
    """
    d = y.shape[1]
    out = np.empty((len(starts), n, d))
    for k in range(len(starts)):
        a = starts[k]
        t = t0 + a * dt
        window = u[2 * n_sub * a : 2 * n_sub * (a + n - 1) + 1]
        x = start_state(kind, p, b, inertia, which, how, x0[k], t, dt, n_sub, window, y[a : a + burn])
        out[k] = run(kind, p, b, inertia, which, how, x, t, dt, n, n_sub, window)[:, :d]
    return out
