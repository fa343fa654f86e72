"""Compiled mechanics of a hanging chain of arcs and rigid links.

The plane is complex: the real axis points down, the imaginary axis to the right of the image. A segment of
bending angle ``theta`` and strain ``eps`` is the arc ``l f(theta, s)``, ``l = length (1 + eps)``, ``f =
int_0^s exp(i theta sigma) d sigma``, rotated by the orientation ``E = exp(i phi)`` of its base. The
coordinates are ``q = (theta_1, eps_1, theta_2, eps_2, ...)``. Mass is spread evenly over the reference
length and summed at Gauss-Legendre nodes, so ``M = sum m J^T J`` and the Coriolis force
``sum m J^T (dJ/dt v)`` is the exact derivative of that ``M``. A row of ``table`` is a segment, with the
columns below.

Source: Renda et al., doi:10.1109/TRO.2018.2868815 (piecewise constant strain), in the plane.
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit

from lagsplat.systems.dynamics import Matrix, Vector

LENGTH, MASS, GYRATION, K_BEND, H_BEND, K_EXT, H_EXT, C_BEND, C_EXT = range(9)
AREA, OFFSET, LIMIT, LINK_LENGTH, LINK_MASS, LINK_INERTIA = range(9, 15)
N_COLUMNS = 15
ATMOSPHERE_PA = 101325.0
LEGENDRE_NODES, LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(8)  # on (-1, 1)
NODES, WEIGHTS = 0.5 * (LEGENDRE_NODES + 1), 0.5 * LEGENDRE_WEIGHTS  # on (0, 1)

Table = Float64[np.ndarray, "n_segments n_columns"]


@njit(cache=True)
@no_type_check
def arc_points(theta: float, s: float) -> tuple[complex, complex, complex]:
    """``f(theta, s)`` of the module docstring and its first two derivatives in ``theta``; exact through 0.

    ``f = s g(x)`` with ``g = exp(ix) sin(x)/x`` and ``x = theta s / 2``.
    """
    x = 0.5 * theta * s
    y = x * x
    if abs(x) < 0.35:
        sinc = 1 - y / 6 * (1 - y / 20 * (1 - y / 42 * (1 - y / 72 * (1 - y / 110))))
        d_sinc = -x / 3 * (1 - y / 10 * (1 - y / 28 * (1 - y / 54 * (1 - y / 88))))
        dd_sinc = -1 / 3 + y / 10 * (
            1 - 5 * y / 84 * (1 - 7 * y / 270 * (1 - 9 * y / 616 * (1 - 11 * y / 1170)))
        )
    else:
        sinc = np.sin(x) / x
        d_sinc = (np.cos(x) - sinc) / x
        dd_sinc = -sinc - 2 * d_sinc / x
    turn = complex(np.cos(x), np.sin(x))
    first = (d_sinc + 1j * sinc) * turn
    second = (dd_sinc + 2j * d_sinc - sinc) * turn
    return s * sinc * turn, 0.5 * s * s * first, 0.25 * s * s * s * second


@njit(cache=True)
@no_type_check
def _add_body(mass, inertia, jacobian, turning, convective, gravity, m, c, force):
    for j in range(jacobian.size):
        c[j] += mass * (jacobian[j].conjugate() * convective).real
        force[j] += mass * gravity * jacobian[j].real
        for k in range(jacobian.size):
            m[j, k] += mass * (jacobian[j].conjugate() * jacobian[k]).real + inertia * turning[j] * turning[k]


@njit(cache=True)
@no_type_check
def chain_inertia(q: Vector, v: Vector, table: Table, gravity: float) -> tuple[Matrix, Vector, Vector]:
    """Mass matrix, Coriolis force ``C(q, v) v`` and generalised weight; ``gravity`` [m/s^2]."""
    d = q.size
    m, c, force = np.zeros((d, d)), np.zeros(d), np.zeros(d)
    origin = np.zeros(d, dtype=np.complex128)
    turning = np.zeros(d)
    jacobian = np.zeros(d, dtype=np.complex128)
    convective_origin = 0j
    orientation, spin = 1 + 0j, 0.0
    for i in range(table.shape[0]):
        row = table[i]
        bend, ext = 2 * i, 2 * i + 1
        length, rate = row[LENGTH] * (1 + q[ext]), row[LENGTH] * v[ext]
        for n in range(NODES.size + 1):
            s = NODES[n] if n < NODES.size else 1.0
            f, f1, f2 = arc_points(q[bend], s)
            jacobian[:] = origin
            for j in range(0, bend, 2):
                jacobian[j] += 1j * orientation * length * f
            jacobian[bend] = orientation * length * f1
            jacobian[ext] = orientation * row[LENGTH] * f
            turning[bend] = s
            convective = convective_origin + orientation * (
                -spin * spin * length * f
                + 2j * spin * (rate * f + length * f1 * v[bend])
                + 2 * rate * f1 * v[bend]
                + length * f2 * v[bend] ** 2
            )
            if n < NODES.size:
                share = row[MASS] * WEIGHTS[n]
                _add_body(share, share * row[GYRATION], jacobian, turning, convective, gravity, m, c, force)
        orientation = orientation * complex(np.cos(q[bend]), np.sin(q[bend]))
        spin += v[bend]
        half = 0.5 * row[LINK_LENGTH]
        for j in range(0, bend + 1, 2):
            jacobian[j] += 1j * orientation * half
        convective -= spin * spin * half * orientation
        _add_body(row[LINK_MASS], row[LINK_INERTIA], jacobian, turning, convective, gravity, m, c, force)
        for j in range(0, bend + 1, 2):
            jacobian[j] += 1j * orientation * half
        convective_origin = convective - spin * spin * half * orientation
        origin[:] = jacobian
    return m, c, force


@njit(cache=True)
@no_type_check
def chamber_volumes(q: Vector, table: Table) -> tuple[Vector, Matrix]:
    """Volumes [m^3] of the chambers (two per segment) and their derivatives ``b(q)``, shape ``(n_u, d)``.

    A chamber of stretch ``x = 1 + eps +- offset theta / length`` wound with inextensible fibre holds ``A
    length x (limit^2 - x^2) / (limit^2 - 1)``. The first chamber of a pair lies left of a hanging arm.

    Source: Chou and Hannaford, doi:10.1109/70.481753, eq. 4 (volume of a braided cylinder).
    """
    n = table.shape[0]
    volumes, slopes = np.zeros(2 * n), np.zeros((2 * n, 2 * n))
    for i in range(n):
        row = table[i]
        limit = row[LIMIT] ** 2
        for side in range(2):
            lever = (1 - 2 * side) * row[OFFSET] / row[LENGTH]
            stretch = 1 + q[2 * i + 1] + lever * q[2 * i]
            scale = row[AREA] * row[LENGTH] / (limit - 1)
            volumes[2 * i + side] = scale * stretch * (limit - stretch**2)
            slope = scale * (limit - 3 * stretch**2)
            slopes[2 * i + side, 2 * i] = lever * slope
            slopes[2 * i + side, 2 * i + 1] = slope
    return volumes, slopes


@njit(cache=True)
@no_type_check
def elastic_force(q: Vector, table: Table) -> Vector:
    """Generalised restoring force of the hardening springs, ``-dV/dq``."""
    force = np.zeros(q.size)
    for i in range(table.shape[0]):
        row = table[i]
        bend, ext = q[2 * i], q[2 * i + 1]
        force[2 * i] = -row[K_BEND] * bend * (1 + row[H_BEND] * bend**2)
        force[2 * i + 1] = -row[K_EXT] * ext * (1 + row[H_EXT] * ext**2)
    return force


@njit(cache=True)
@no_type_check
def acceleration(q: Vector, v: Vector, pressure: Vector, table: Table, gravity: float) -> Vector:
    """``M^-1 (b^T p + weight + elastic - D v - C v)`` in 1/s^2; ``pressure`` [atm], ``gravity`` [m/s^2]."""
    m, c, weight = chain_inertia(q, v, table, gravity)
    slopes = chamber_volumes(q, table)[1]
    force = weight + elastic_force(q, table) - c
    for j in range(q.size):
        force[j] -= table[j // 2, C_BEND + j % 2] * v[j]
        for k in range(pressure.size):
            force[j] += ATMOSPHERE_PA * pressure[k] * slopes[k, j]
    return np.linalg.solve(m, force)
