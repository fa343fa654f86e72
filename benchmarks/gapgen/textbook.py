"""Equations of mechanisms as other authors state them, about the hanging rest.

Cart-pole: Barto, Sutton and Anderson (1983), a uniform pole on a cart, with a spring on the cart. Acrobot:
Spong (1995) in the symbols of Sutton and Barto. Rotary pendulum of Furuta: Cazzolato and Prime (2011) with
slender links, with a spring on the arm. Each fills inertia (d, d) and, each (d,), centrifugal force, damping
force and gradient of the potential.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def cart_pole(p, q, v, mass, bias, drag, grad):
    """Terms of p = (cart, pole, half length, gravity, spring, damping of the cart, of the pole)."""
    pole_mass_length = p[1] * p[2]
    mass[0, 0] = p[0] + p[1]
    mass[0, 1] = -pole_mass_length * np.cos(q[1])
    mass[1, 0] = mass[0, 1]
    mass[1, 1] = 4.0 / 3.0 * pole_mass_length * p[2]
    bias[0] = pole_mass_length * np.sin(q[1]) * v[1] * v[1]
    bias[1] = 0.0
    drag[0] = p[5] * v[0]
    drag[1] = p[6] * v[1]
    grad[0] = p[4] * q[0]
    grad[1] = pole_mass_length * p[3] * np.sin(q[1])


@njit(cache=True)
def acrobot(p, q, v, mass, bias, drag, grad):
    """Terms of p = (m1, m2, l1, lc1, lc2, I1, I2, gravity, damping of the shoulder, of the elbow)."""
    m1, m2, l1, lc1, lc2 = p[0], p[1], p[2], p[3], p[4]
    arm = m2 * l1 * lc2
    d2 = m2 * lc2**2 + arm * np.cos(q[1]) + p[6]
    mass[0, 0] = m1 * lc1**2 + m2 * (l1**2 + lc2**2) + 2.0 * arm * np.cos(q[1]) + p[5] + p[6]
    mass[0, 1] = d2
    mass[1, 0] = d2
    mass[1, 1] = m2 * lc2**2 + p[6]
    bias[0] = -arm * np.sin(q[1]) * (v[1] ** 2 + 2.0 * v[0] * v[1])
    bias[1] = arm * np.sin(q[1]) * v[0] ** 2
    drag[0] = p[8] * v[0]
    drag[1] = p[9] * v[1]
    grad[1] = m2 * lc2 * p[7] * np.sin(q[0] + q[1])
    grad[0] = (m1 * lc1 + m2 * l1) * p[7] * np.sin(q[0]) + grad[1]


@njit(cache=True)
def furuta(p, q, v, mass, bias, drag, grad):
    """Terms of p = (arm's inertia, m, arm's length, l, J, gravity, spring, damping of the arm, of the pole).

    ``J`` is the pole's inertia about its pivot, ``l`` the distance of its centre of mass.
    """
    arm, swing = p[1] * p[2] * p[3], p[4]
    sine, cosine = np.sin(q[1]), np.cos(q[1])
    mass[0, 0] = p[0] + p[1] * p[2] ** 2 + swing * sine**2
    mass[0, 1] = arm * cosine
    mass[1, 0] = mass[0, 1]
    mass[1, 1] = swing
    bias[0] = 2.0 * swing * sine * cosine * v[0] * v[1] - arm * sine * v[1] ** 2
    bias[1] = -swing * sine * cosine * v[0] ** 2
    drag[0] = p[7] * v[0]
    drag[1] = p[8] * v[1]
    grad[0] = p[6] * q[0]
    grad[1] = p[1] * p[5] * p[3] * sine
