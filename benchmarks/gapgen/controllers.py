"""Mechanisms under position control: every input is the target of a coordinate."""

from dataclasses import replace

import numpy as np

from benchmarks.gapgen.mechanisms import CART, CART_POLE, CHAIN, FURUTA, ROTATIONAL_ACTUATOR, Mechanism
from benchmarks.gapgen.mujoco_world import MUJOCO, MujocoMechanism

CONTROLLED = (
    *("pendulum", "linear_cart", "duffing_cart", "two_link", "cart_pole", "furuta", "rotational_actuator"),
    *MUJOCO,
)
SPRING_SLOTS = {CART: 2, CART_POLE: 4, FURUTA: 6, ROTATIONAL_ACTUATOR: 4}
DAMPING_SLOTS = {CART: 1, CART_POLE: 5, FURUTA: 7, ROTATIONAL_ACTUATOR: 6}


def under_control(m: Mechanism, rng: np.random.Generator) -> Mechanism:
    """The mechanism with position controllers: their gains are springs and damping of its equations.

    Links are controlled at every joint, carts and the arm at the first coordinate, where the controller
    takes the place of the spring. In MuJoCo they are position actuators beside what is there.

    Raises:
        ValueError: if the mechanism has no place for them.
    """
    inertia, stiffness = np.diag(m.inertia_at_rest()), np.diag(m.stiffness_at_rest())
    kp = stiffness * rng.uniform(0.5, 2.0, m.d)
    kd = 2.0 * rng.uniform(0.02, 0.15, m.d) * np.sqrt((stiffness + kp) * inertia)
    if isinstance(m, MujocoMechanism):
        return replace(m, b=np.diag(kp), kv=kd)
    p = m.p.copy()
    if m.kind == CHAIN:
        p[1 + 3 * m.d : 1 + 4 * m.d] += kp
        p[1 + 4 * m.d : 1 + 5 * m.d] += kd
        return replace(m, p=p, b=np.diag(kp))
    if m.kind not in SPRING_SLOTS:
        raise ValueError(f"{m.system}: has no place for a position controller; choose from {CONTROLLED}")
    p[DAMPING_SLOTS[m.kind]] += kd[0]
    b = np.zeros((m.d, 1))
    b[0, 0] = p[SPRING_SLOTS[m.kind]]
    return replace(m, p=p, b=b)
