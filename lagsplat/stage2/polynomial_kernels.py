# mypy: ignore-errors
"""Compiled rollouts of polynomial laws and their variational equations.

They are those of `lagsplat.stage2.lagrangian`, in the coordinates of the law: with ``w = J v``,
``A_il = sum_j dJ_ij/dx_l v_j`` and ``e = J a + A v`` the balance of forces is
``J^T (M_0 e + C_0 w) + floors - (A - dJ/dt)^T M_0 w + grad U = 0``. Steps are those of
`lagsplat.stage2.runge_kutta`. Numba compiles these functions and infers their types, so they carry no
annotations.

Every monomial is an earlier one, its parent, times one variable; the first is one. So values, slopes and
second derivatives of all follow from the product rule. They are those of the softly clipped state, but for
the linear and quadratic ones of the potential and the linear ones of the volumes, which are of the state.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., I.14 (variational
equations) and II.1.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

NODES, REACH = (0, 1, 1, 2), (0.0, 0.5, 0.5, 1.0)  # input and share of the step of each stage
SHARES = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)


class LawArrays(NamedTuple):
    """A polynomial law of ``d`` coordinates and ``c`` inputs; monomial 0 of ``m`` is the constant one."""

    parents: np.ndarray  # (m,)
    variables: np.ndarray  # (m,)
    center: np.ndarray  # (d,) of the ball in which polynomials are free
    radius: float
    room: float
    energy: np.ndarray  # (m,) coefficients of V, with zeros for those it lacks
    volumes: np.ndarray  # (c, m) of the volume of each input
    n_energy: int  # monomials of V, the constant one not counted
    n_volumes: int
    n_springs: int  # monomials up to the quadratic ones, the constant one counted
    frame: np.ndarray  # (k, d, d) coefficients of the monomials 1 to k
    mass_factor: np.ndarray  # (d, d) lower triangular, as the next
    damping_factor: np.ndarray
    mass_floor: float
    damping_floor: float


def list_parents(exponents):
    """Parent and variable of each monomial, the constant one first.

    Args:
        exponents: (m - 1, d) of the others, by degree.
    """
    rows = [
        tuple(row) for row in np.vstack([np.zeros((1, exponents.shape[1])), exponents]).astype(int).tolist()
    ]
    place = {row: k for k, row in enumerate(rows)}
    variables = np.array([max(i for i, power in enumerate(row) if power or not any(row)) for row in rows])
    parents = [0]
    for row, i in zip(rows[1:], variables[1:], strict=True):
        parents.append(place[(*row[:i], row[i] - 1, *row[i + 1 :])])
    return np.array(parents), variables


@njit(cache=True)
def _clip(x, law, z):
    """Write the offset from the center to ``z``, and compute the soft clip; its share is 1 in the ball."""
    square = 0.0
    for i in range(len(x)):
        z[i] = x[i] - law.center[i]
        square += z[i] * z[i]
    r = math.sqrt(square)
    if not r > law.radius:
        return 1.0, 0.0, 0.0
    tanh = math.tanh((r - law.radius) / (law.room * law.radius))
    slope = 1.0 - tanh * tanh
    bend = -2.0 / (law.room * law.radius) * tanh * slope
    share = law.radius * (1.0 + law.room * tanh) / r
    first = (slope - share) / r
    turned = first / r
    curved = ((bend - 2.0 * first) / r - turned) / (r * r)
    return share, turned, curved


@njit(cache=True)
def _evaluate(x, law, z, value, slope):
    """Fill values (m,) and slopes (m, d) of the monomials of the clipped state, by that state."""
    share, turned, curved = _clip(x, law, z)
    d, m = len(x), len(value)
    value[0] = 1.0
    for a in range(d):
        slope[0, a] = 0.0
    for k in range(1, m):
        parent, i = law.parents[k], law.variables[k]
        s = law.center[i] + share * z[i]
        value[k] = value[parent] * s
        for a in range(d):
            slope[k, a] = slope[parent, a] * s
        slope[k, i] += value[parent]
    return share, turned, curved


@njit(cache=True)
def _bend(law, share, z, value, slope, bend):
    """Fill second derivatives (k, d, d) of the first monomials by the clipped state."""
    d = slope.shape[1]
    bend[0] = 0.0
    for k in range(1, len(bend)):
        parent, i = law.parents[k], law.variables[k]
        s = law.center[i] + share * z[i]
        for a in range(d):
            for b in range(d):
                bend[k, a, b] = bend[parent, a, b] * s
        for a in range(d):
            bend[k, i, a] += slope[parent, a]
            bend[k, a, i] += slope[parent, a]


@njit(cache=True)
def _pull_back(z, share, turned, slope):
    """Turn slopes (m, d) by the clipped state into slopes by the state."""
    for k in range(len(slope)):
        along = 0.0
        for a in range(len(z)):
            along += slope[k, a] * z[a]
        for a in range(len(z)):
            slope[k, a] = share * slope[k, a] + turned * along * z[a]


@njit(cache=True)
def _pull_back_bends(z, share, turned, curved, slope, bend):
    """Turn second derivatives by the clipped state into those by the state; ``slope`` is by the former."""
    d = len(z)
    jacobian, half = np.empty((d, d)), np.empty((d, d))
    for a in range(d):
        for b in range(d):
            jacobian[a, b] = turned * z[a] * z[b] + (share if a == b else 0.0)
    for k in range(len(bend)):
        along = 0.0
        for a in range(d):
            along += slope[k, a] * z[a]
        _multiply(bend[k], jacobian, half)
        _multiply(jacobian, half, bend[k])
        for a in range(d):
            for b in range(d):
                own = slope[k, a] * z[b] + slope[k, b] * z[a] + (along if a == b else 0.0)
                bend[k, a, b] += turned * own + curved * along * z[a] * z[b]


@njit(cache=True)
def _bend_load(law, clip, z, value, slope, load, total):
    """Add second derivatives (d, d) by the state: of the sum of the loaded monomials beyond the linear ones.

    The sum is differentiated backwards from the last monomial to the first, and that along each variable, so
    that no second derivative of a single monomial is needed. ``slope`` is by the clipped state.
    """
    share, turned, curved = clip
    m, d = slope.shape
    back, along = np.zeros(m), np.zeros((m, d))
    gradient, bend = np.zeros(d), np.zeros((d, d))
    for k in range(m - 1, 0, -1):
        parent, i = law.parents[k], law.variables[k]
        s = law.center[i] + share * z[i]
        if k > d:
            back[k] += load[k]
        back[parent] += back[k] * s
        gradient[i] += back[k] * value[parent]
        for b in range(d):
            along[parent, b] += along[k, b] * s
            bend[i, b] += along[k, b] * value[parent] + back[k] * slope[parent, b]
        along[parent, i] += back[k]
    if turned == 0.0:
        total += bend
        return
    jacobian, half, outer = np.empty((d, d)), np.empty((d, d)), 0.0
    for a in range(d):
        outer += gradient[a] * z[a]
        for b in range(d):
            jacobian[a, b] = turned * z[a] * z[b] + (share if a == b else 0.0)
    _multiply(bend, jacobian, half)
    _multiply(jacobian, half, bend)
    for a in range(d):
        for b in range(d):
            own = gradient[a] * z[b] + gradient[b] * z[a] + (outer if a == b else 0.0)
            total[a, b] += bend[a, b] + turned * own + curved * outer * z[a] * z[b]


@njit(cache=True)
def _multiply(a, b, out):
    """Write ``a b`` to ``out``."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
        for k in range(a.shape[1]):
            factor = a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += factor * b[k, j]


@njit(cache=True)
def _invert(matrix, out):
    """Write the inverse of a positive definite matrix to ``out``, NaN if it is not."""
    d = len(matrix)
    lower = np.zeros((d, d))
    for i in range(d):
        for j in range(i + 1):
            left = matrix[i, j]
            for k in range(j):
                left -= lower[i, k] * lower[j, k]
            if i == j:
                lower[i, i] = math.sqrt(left) if left > 0.0 else math.nan
            else:
                lower[i, j] = left / lower[j, j]
    for c in range(d):
        for i in range(d):
            left = 1.0 if i == c else 0.0
            for k in range(i):
                left -= lower[i, k] * out[k, c]
            out[i, c] = left / lower[i, i]
        for i in range(d - 1, -1, -1):
            left = out[i, c]
            for k in range(i + 1, d):
                left -= lower[k, i] * out[k, c]
            out[i, c] = left / lower[i, i]


class Balance(NamedTuple):
    """What the balance of forces at one state is made of, as arrays that are written in place."""

    z: np.ndarray  # (d,)
    value: np.ndarray  # (m,)
    slope: np.ndarray  # (m, d)
    load: np.ndarray  # (m,) coefficients of U under the input
    frame: np.ndarray  # (d, d) J
    frame_by_x: np.ndarray  # (d, d, d)
    moved: np.ndarray  # (d, d) A
    rate: np.ndarray  # (d, d) dJ/dt
    carried: np.ndarray  # (d, d) J^T M_0
    drag: np.ndarray  # (d, d) J^T C_0 - (A - dJ/dt)^T M_0
    inverse_mass: np.ndarray  # (d, d)
    w: np.ndarray  # (d,)
    momentum: np.ndarray  # (d,) M_0 w
    acceleration: np.ndarray  # (d,)


@njit(cache=True)
def _make_balance(d, m):
    return Balance(
        np.empty(d),
        np.empty(m),
        np.empty((m, d)),
        np.empty(m),
        np.empty((d, d)),
        np.empty((d, d, d)),
        np.empty((d, d)),
        np.empty((d, d)),
        np.empty((d, d)),
        np.empty((d, d)),
        np.empty((d, d)),
        np.empty(d),
        np.empty(d),
        np.empty(d),
    )


@njit(cache=True)
def _fill_frame(law, share, turned, at):
    """Fill the frame and its derivatives from the monomials."""
    d, bent = len(at.w), len(law.frame)
    at.frame[:] = 0.0
    at.frame_by_x[:] = 0.0
    for a in range(d):
        at.frame[a, a] = 1.0
    for k in range(bent):
        along = 0.0
        for a in range(d):
            along += at.slope[k + 1, a] * at.z[a]
        for i in range(d):
            for j in range(d):
                at.frame[i, j] += at.value[k + 1] * law.frame[k, i, j]
                for r in range(d):
                    by_x = share * at.slope[k + 1, r] + turned * along * at.z[r]
                    at.frame_by_x[i, j, r] += by_x * law.frame[k, i, j]


@njit(cache=True)
def _compute_force(law, x, u, share, turned, at):
    """Force (d,) of the energy under an input; fills the loads of the clipped monomials."""
    d, m = len(x), len(law.energy)
    for k in range(1, m):
        at.load[k] = law.energy[k] if k >= law.n_springs else 0.0
        if k > d:
            for c in range(len(u)):
                at.load[k] -= u[c] * law.volumes[c, k]
    force = np.zeros(d)
    for k in range(d + 1, m):
        for a in range(d):
            force[a] -= at.load[k] * at.slope[k, a]
    if turned != 0.0:
        along = 0.0
        for a in range(d):
            along += force[a] * at.z[a]
        for a in range(d):
            force[a] = share * force[a] + turned * along * at.z[a]
    for k in range(1, d + 1):
        load = law.energy[k]
        for c in range(len(u)):
            load -= u[c] * law.volumes[c, k]
        force[law.variables[k]] -= load
    for k in range(d + 1, min(law.n_springs, m)):
        i, j = law.variables[law.parents[k]], law.variables[k]
        force[i] -= law.energy[k] * x[j]
        force[j] -= law.energy[k] * x[i]
    return force


@njit(cache=True)
def _solve_balance(law, inertia, viscosity, x, v, u, at):
    """Fill ``at`` for one state; returns the coefficients of its soft clip."""
    d = len(x)
    clip = _evaluate(x, law, at.z, at.value, at.slope)
    share, turned, _ = clip
    force = _compute_force(law, x, u, share, turned, at)
    _fill_frame(law, share, turned, at)
    for i in range(d):
        at.w[i] = 0.0
        for r in range(d):
            at.w[i] += at.frame[i, r] * v[r]
            at.moved[i, r] = 0.0
            at.rate[i, r] = 0.0
            for j in range(d):
                at.moved[i, r] += at.frame_by_x[i, j, r] * v[j]
                at.rate[i, r] += at.frame_by_x[i, r, j] * v[j]
    for i in range(d):
        at.momentum[i] = 0.0
        for j in range(d):
            at.momentum[i] += inertia[i, j] * at.w[j]
    for i in range(d):
        for j in range(d):
            carried, drag = 0.0, 0.0
            for k in range(d):
                turning = at.moved[k, i] - at.rate[k, i]
                carried += at.frame[k, i] * inertia[k, j]
                drag += at.frame[k, i] * viscosity[k, j] - turning * inertia[k, j]
            at.carried[i, j] = carried
            at.drag[i, j] = drag
    mass = np.empty((d, d))
    _multiply(at.carried, at.frame, mass)
    for a in range(d):
        mass[a, a] += law.mass_floor
        force[a] -= law.damping_floor * v[a]
    for i in range(d):
        bend = 0.0
        for r in range(d):
            bend += at.moved[i, r] * v[r]
        for a in range(d):
            force[a] -= at.carried[a, i] * bend + at.drag[a, i] * at.w[i]
    _invert(mass, at.inverse_mass)
    for a in range(d):
        at.acceleration[a] = 0.0
        for b in range(d):
            at.acceleration[a] += at.inverse_mass[a, b] * force[b]
    return clip


@njit(cache=True)
def roll_out(law, starts, inputs, steps):
    """States (K, n + 1, 2 d) of all windows, the start included.

    ``starts`` (K, 2 d) are positions and velocities, ``inputs`` (K, n, nodes, c) at the nodes of each frame,
    ``steps`` (K, n) the time between frames.
    """
    n_windows, n, nodes, _ = inputs.shape
    s = starts.shape[1]
    d, pieces = s // 2, nodes // 2
    inertia, viscosity = law.mass_factor @ law.mass_factor.T, law.damping_factor @ law.damping_factor.T
    at = _make_balance(d, len(law.energy))
    path = np.empty((n_windows, n + 1, s))
    state, stage, rates = np.empty(s), np.empty(s), np.empty((4, s))
    for i in range(n_windows):
        path[i, 0] = starts[i]
        state[:] = starts[i]
        for frame in range(n):
            h = steps[i, frame] / pieces
            for piece in range(pieces):
                for j in range(4):
                    for a in range(s):
                        stage[a] = state[a] + (REACH[j] * h * rates[j - 1, a] if j else 0.0)
                    u = inputs[i, frame, 2 * piece + NODES[j]]
                    _solve_balance(law, inertia, viscosity, stage[:d], stage[d:], u, at)
                    for a in range(d):
                        rates[j, a] = stage[d + a]
                        rates[j, d + a] = at.acceleration[a]
                for a in range(s):
                    for j in range(4):
                        state[a] += h * SHARES[j] * rates[j, a]
            path[i, frame + 1] = state
    return path


@njit(cache=True)
def differentiate_path(law, path, inputs, steps):
    """Derivatives of the states of `roll_out` by the start of their window and by the parameters.

    Returns those of every state by the start (K, n + 1, 2 d, 2 d), and by the parameters those of every
    position but the last (K, n, d, p) and of the last state (K, 2 d, p). The parameters are those of the
    factor of mass, of the frame, of the factor of damping, of the energy and of the volumes.
    """
    n_windows, n, nodes, c = inputs.shape
    s = path.shape[2]
    d, pieces, m = s // 2, nodes // 2, len(law.energy)
    p = 2 * d * d + law.frame.size + law.n_energy + c * law.n_volumes
    inertia, viscosity = law.mass_factor @ law.mass_factor.T, law.damping_factor @ law.damping_factor.T
    at, bend = _make_balance(d, m), np.empty((1 + len(law.frame), d, d))
    transition, by_law = np.zeros((n_windows, n + 1, s, s)), np.zeros((n_windows, n, d, p))
    last, own_law = np.zeros((n_windows, s, p)), np.empty((s, p))
    state, stage, rates = np.empty(s), np.empty(s), np.empty((4, s))
    slopes, weight, moved = np.zeros((4, s, s)), np.empty((4, s, s)), np.empty((s, d))
    by_start, own, inverse_mass = np.empty((s, s)), np.empty((s, s)), np.empty((4, d, d))
    # one product adds up what the state before and the four stages pass on
    passed, parts = np.empty((s, s + 4 * d)), np.empty((s + 4 * d, p))
    for j in range(4):
        for a in range(d):
            slopes[j, a, d + a] = 1.0
    for i in range(n_windows):
        for a in range(s):
            transition[i, 0, a, a] = 1.0
        parts[:s] = 0.0
        for frame in range(n):
            h = steps[i, frame] / pieces
            state[:] = path[i, frame]
            own[:] = transition[i, frame]
            by_law[i, frame] = parts[:d]
            for piece in range(pieces):
                for j in range(4):
                    for a in range(s):
                        stage[a] = state[a] + (REACH[j] * h * rates[j - 1, a] if j else 0.0)
                    x, v, u = stage[:d], stage[d:], inputs[i, frame, 2 * piece + NODES[j]]
                    clip = _solve_balance(law, inertia, viscosity, x, v, u, at)
                    rows = parts[s + j * d : s + (j + 1) * d]
                    _differentiate(law, inertia, viscosity, clip, x, v, u, at, bend, slopes[j], rows)
                    inverse_mass[j] = at.inverse_mass
                    for a in range(d):
                        rates[j, a] = v[a]
                        rates[j, d + a] = at.acceleration[a]
                _weigh_stages(slopes, h, weight, by_start)
                _multiply(by_start, own, transition[i, frame + 1])
                own[:] = transition[i, frame + 1]
                passed[:, :s] = by_start
                for j in range(4):
                    _multiply(weight[j, :, d:], inverse_mass[j], moved)
                    for a in range(s):
                        for b in range(d):
                            passed[a, s + j * d + b] = -moved[a, b]
                np.dot(passed, parts, own_law)
                parts[:s] = own_law
                for a in range(s):
                    for j in range(4):
                        state[a] += h * SHARES[j] * rates[j, a]
        last[i] = parts[:s]
    return transition, by_law, last


@njit(cache=True)
def _weigh_stages(slopes, h, weight, by_start):
    """Derivatives of a Runge-Kutta step's end by the rate at each stage, and by its start."""
    s = by_start.shape[0]
    for j in range(3, -1, -1):
        weight[j] = 0.0
        if j < 3:
            _multiply(weight[j + 1], slopes[j + 1], weight[j])
        for a in range(s):
            for b in range(s):
                weight[j, a, b] *= REACH[j + 1] * h if j < 3 else 0.0
            weight[j, a, a] += SHARES[j] * h
    by_start[:] = 0.0
    for a in range(s):
        by_start[a, a] = 1.0
        for j in range(4):
            for k in range(s):
                for b in range(s):
                    by_start[a, b] += weight[j, a, k] * slopes[j, k, b]


@njit(cache=True)
def _differentiate(law, inertia, viscosity, clip, x, v, u, at, bend, slopes, rows):
    """Derivatives of the acceleration by the state, in the lower half of ``slopes`` (2 d, 2 d), and of
    ``M a`` less all forces by each parameter, in ``rows`` (d, p)."""
    share, turned, curved = clip
    d, m, bent = len(v), len(law.energy), len(law.frame)
    by_x, by_v, e_by_x = np.zeros((d, d)), np.empty((d, d)), np.zeros((d, d))
    _bend_load(law, clip, at.z, at.value, at.slope, at.load, by_x)
    _bend(law, share, at.z, at.value, at.slope, bend)
    if turned != 0.0:
        _pull_back_bends(at.z, share, turned, curved, at.slope, bend)
        _pull_back(at.z, share, turned, at.slope)
    a, w, z = at.acceleration, at.w, at.momentum
    e, force = np.zeros(d), np.zeros(d)
    for i in range(d):
        for j in range(d):
            e[i] += at.frame[i, j] * a[j] + at.moved[i, j] * v[j]
    for i in range(d):
        for j in range(d):
            force[i] += inertia[i, j] * e[j] + viscosity[i, j] * w[j]
    spread, swept = np.zeros((bent, d)), np.zeros((bent, d))
    for k in range(bent):
        for i in range(d):
            for j in range(d):
                spread[k, i] += law.frame[k, i, j] * v[j]
                swept[k, i] += bend[k + 1, j, i] * v[j]
    for i in range(d):
        for r in range(d):
            for j in range(d):
                e_by_x[i, r] += at.frame_by_x[i, j, r] * a[j]
            for k in range(bent):
                e_by_x[i, r] += spread[k, i] * swept[k, r]
    for k in range(d + 1, min(law.n_springs, m)):
        i, j = law.variables[law.parents[k]], law.variables[k]
        by_x[i, j] += law.energy[k]
        by_x[j, i] += law.energy[k]
    for r in range(d):
        for q in range(d):
            v_part = 0.0
            x_part = 0.0
            for i in range(d):
                v_part += at.carried[r, i] * (at.rate[i, q] + at.moved[i, q]) + at.drag[r, i] * at.frame[i, q]
                v_part -= z[i] * (at.frame_by_x[i, q, r] - at.frame_by_x[i, r, q])
                x_part += at.carried[r, i] * e_by_x[i, q] + at.drag[r, i] * at.moved[i, q]
                x_part += at.frame_by_x[i, r, q] * force[i]
                for k in range(bent):
                    x_part -= spread[k, i] * z[i] * bend[k + 1, r, q]
                    x_part += law.frame[k, i, r] * z[i] * swept[k, q]
            by_x[r, q] += x_part
            by_v[r, q] = v_part
        by_v[r, r] += law.damping_floor
    for r in range(d):
        for q in range(d):
            slopes[d + r, q] = 0.0
            slopes[d + r, d + q] = 0.0
            for i in range(d):
                slopes[d + r, q] -= at.inverse_mass[r, i] * by_x[i, q]
                slopes[d + r, d + q] -= at.inverse_mass[r, i] * by_v[i, q]
    _differentiate_by_parameters(law, x, v, u, at, e, force, rows)


@njit(cache=True)
def _vary_factor(factor, side, x, sign, rows):
    """Add derivatives of ``sign side^T L L^T x`` by the lower triangle of ``L`` to ``rows`` (d, d d)."""
    d = len(x)
    for j in range(d):
        along = 0.0
        for i in range(d):
            along += factor[i, j] * x[i]
        for r in range(d):
            carried = 0.0
            for i in range(d):
                carried += side[i, r] * factor[i, j]
            for i in range(j, d):
                rows[r, i * d + j] += sign * (side[i, r] * along + carried * x[i])


@njit(cache=True)
def _differentiate_by_parameters(law, x, v, u, at, e, force, rows):
    """Fill derivatives (d, p) of ``M a`` less all forces, at a fixed ``a``, by each parameter."""
    d, bent, w, z = len(v), len(law.frame), at.w, at.momentum
    square, turning = d * d, at.moved - at.rate
    rows[:] = 0.0
    _vary_factor(law.mass_factor, at.frame, e, 1.0, rows)
    _vary_factor(law.mass_factor, turning, w, -1.0, rows)
    first = square + bent * square
    _vary_factor(law.damping_factor, at.frame, w, 1.0, rows[:, first:])
    for k in range(bent):
        swift = 0.0
        for r in range(d):
            swift += at.slope[k + 1, r] * v[r]
        for i in range(d):
            own = at.value[k + 1] * force[i] + swift * z[i]
            for j in range(d):
                column = square + (k * d + i) * d + j
                moved = at.value[k + 1] * at.acceleration[j] + swift * v[j]
                for r in range(d):
                    value = at.carried[r, i] * moved + at.drag[r, i] * at.value[k + 1] * v[j]
                    rows[r, column] = value - v[j] * at.slope[k + 1, r] * z[i]
                rows[j, column] += own
    first += square
    for k in range(law.n_energy):
        j, parent = law.variables[k + 1], law.parents[k + 1]
        if k < d:
            rows[j, first + k] = 1.0
        elif k + 1 < law.n_springs:
            rows[law.variables[parent], first + k] += x[j]
            rows[j, first + k] += x[law.variables[parent]]
        else:
            for r in range(d):
                rows[r, first + k] = at.slope[k + 1, r]
    first += law.n_energy
    for c in range(len(u)):
        for k in range(law.n_volumes):
            if k < d:
                rows[law.variables[k + 1], first + c * law.n_volumes + k] = -u[c]
            else:
                for r in range(d):
                    rows[r, first + c * law.n_volumes + k] = -u[c] * at.slope[k + 1, r]
