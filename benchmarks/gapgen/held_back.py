"""Mechanisms that no verdict is calibrated on, kept for a sealed split: forms of five further fields.

Rolling ship: Nayfeh and Khdeir (1986), softening and then hardening, with quadratic damping. Bead on a hoop
that turns slowly: Strogatz, Nonlinear Dynamics and Chaos, 3.5. Elastic joint: Spong (1987), a hanging link
and the motor behind a spring. Quarter of a car: Hrovat (1997), with a spring that hardens. Rotational
actuator on a sprung cart: Bupp, Bernstein and Coppola (1998), upright in gravity. Each fills inertia (d, d)
and, each (d,), centrifugal force, damping force and gradient of the potential.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def ship_roll(p, q, v, mass, bias, drag, grad):
    """Terms of p = (inertia, linear damping, quadratic damping, stiffness, softening, hardening)."""
    mass[0, 0] = p[0]
    bias[0] = 0.0
    drag[0] = (p[1] + p[2] * abs(v[0])) * v[0]
    grad[0] = (p[3] - p[4] * q[0] ** 2 + p[5] * q[0] ** 4) * q[0]


@njit(cache=True)
def bead_on_hoop(p, q, v, mass, bias, drag, grad):
    """Terms of p = (inertia, damping, gravity over radius, square of the hoop's rate)."""
    mass[0, 0] = p[0]
    bias[0] = 0.0
    drag[0] = p[1] * v[0]
    grad[0] = p[0] * np.sin(q[0]) * (p[2] - p[3] * np.cos(q[0]))


@njit(cache=True)
def elastic_joint(p, q, v, mass, bias, drag, grad):
    """Terms of p = (link, weight times its arm, spring, motor, damping of the link, of the motor)."""
    mass[0, 0] = p[0]
    mass[0, 1] = 0.0
    mass[1, 0] = 0.0
    mass[1, 1] = p[3]
    bias[:] = 0.0
    drag[0] = p[4] * v[0]
    drag[1] = p[5] * v[1]
    twist = p[2] * (q[0] - q[1])
    grad[0] = p[1] * np.sin(q[0]) + twist
    grad[1] = -twist


@njit(cache=True)
def quarter_car(p, q, v, mass, bias, drag, grad):
    """Terms of p = (body, wheel, spring, hardening, tyre, damper, damping of the body, of the tyre)."""
    mass[0, 0] = p[0]
    mass[0, 1] = 0.0
    mass[1, 0] = 0.0
    mass[1, 1] = p[1]
    bias[:] = 0.0
    stretch = q[0] - q[1]
    spring, damper = (p[2] + p[3] * stretch**2) * stretch, p[5] * (v[0] - v[1])
    drag[0] = damper + p[6] * v[0]
    drag[1] = -damper + p[7] * v[1]
    grad[0] = spring
    grad[1] = -spring + p[4] * q[1]


@njit(cache=True)
def rotational_actuator(p, q, v, mass, bias, drag, grad):
    """Terms of p = (cart, m, eccentricity, inertia, spring, gravity, damping of the cart, of the rotor)."""
    arm = p[1] * p[2]
    mass[0, 0] = p[0] + p[1]
    mass[0, 1] = arm * np.cos(q[1])
    mass[1, 0] = mass[0, 1]
    mass[1, 1] = p[3] + arm * p[2]
    bias[0] = -arm * np.sin(q[1]) * v[1] ** 2
    bias[1] = 0.0
    drag[0] = p[6] * v[0]
    drag[1] = p[7] * v[1]
    grad[0] = p[4] * q[0]
    grad[1] = arm * p[5] * np.sin(q[1])
