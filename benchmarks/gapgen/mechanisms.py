"""Mechanisms whose recordings are made: open chains, a rocker, a cart on a spring, an elastic pendulum,
those of textbooks, and those held back from calibrations.

Each is ``M(q) a = f - h(q, v) - C v - grad V(q) + B u`` with its rest at ``q = 0``. Angles are in radians,
lengths in metres, and every parameter is drawn anew for every recording.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.gapgen.held_back import (
    bead_on_hoop,
    elastic_joint,
    quarter_car,
    rotational_actuator,
    ship_roll,
)
from benchmarks.gapgen.textbook import acrobot, cart_pole, furuta

Array = NDArray[np.float64]
CHAIN, ROCKER, CART, BAG = 0, 1, 2, 3
# in the form of other authors
CART_POLE, ACROBOT, FURUTA = 4, 5, 6
SHIP_ROLL, BEAD_ON_HOOP, ELASTIC_JOINT, QUARTER_CAR, ROTATIONAL_ACTUATOR = 7, 8, 9, 10, 11


@dataclass(frozen=True)
class Mechanism:
    """Parameters of one mechanism.

    ``kind`` picks the equations, ``p`` (n_p,) holds their parameters, ``b`` (d, n_u) maps inputs to
    generalised forces, ``size`` (d,) is the reach of each coordinate that a user would drive it to.
    """

    system: str
    kind: int
    d: int
    p: Array
    b: Array
    size: Array

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return int(self.b.shape[1])

    def inertia_at_rest(self) -> Array:
        """Inertia matrix at rest, (d, d)."""
        return self._linear()[0]

    def stiffness_at_rest(self) -> Array:
        """Hessian of the potential at rest, (d, d)."""
        return self._linear()[1]

    def frequencies_hz(self) -> Array:
        """Natural frequencies at rest in hertz, ascending, (d,)."""
        inertia, stiffness = self._linear()
        squares = np.linalg.eigvals(np.linalg.solve(inertia, stiffness)).real
        return np.sqrt(np.sort(np.maximum(squares, 1e-12))) / (2.0 * np.pi)

    def damping_at_rest(self) -> Array:
        """Damping force of every coordinate at unit speed of all, (d,)."""
        work = [np.zeros((self.d, self.d)), np.zeros(self.d), np.zeros(self.d), np.zeros(self.d)]
        terms(self.kind, self.p, np.zeros(self.d), np.ones(self.d), *work)
        return work[2]

    def _linear(self) -> tuple[Array, Array]:
        d = self.d
        mass, bias, drag, grad = np.zeros((d, d)), np.zeros(d), np.zeros(d), np.zeros(d)
        v = np.zeros(d)
        stiffness = np.zeros((d, d))
        for j in range(d):
            h = 1e-4 * self.size[j]
            for sign in (1.0, -1.0):
                q = np.zeros(d)
                q[j] = sign * h
                terms(self.kind, self.p, q, v, mass, bias, drag, grad)
                stiffness[:, j] += sign * grad / (2.0 * h)
        terms(self.kind, self.p, np.zeros(d), v, mass, bias, drag, grad)
        return mass.copy(), stiffness

    def perturbed(self, rng: np.random.Generator, size: float) -> "Mechanism":
        """The same mechanism, every parameter off by about ``size`` (relative), damping by four times it."""
        factor = np.exp(rng.normal(0.0, size, len(self.p)))
        c = self._damping_slots()
        factor[c] = np.exp(rng.normal(0.0, min(4.0 * size, 0.1), len(c)))
        if self.kind == CHAIN:
            factor[0] = 1.0
        b = self.b * np.exp(rng.normal(0.0, size, self.b.shape))
        return replace(self, p=self.p * factor, b=b)

    def _damping_slots(self) -> list[int]:
        return damping_slots(self.kind, self.d)


def damping_slots(kind: int, d: int) -> list[int]:
    """Positions of the damping coefficients in the parameters."""
    if kind == CHAIN:
        return list(range(1 + 4 * d, 1 + 5 * d))
    slots = {
        **{ROCKER: [2], CART: [1], BAG: [4, 5], CART_POLE: [5, 6], ACROBOT: [8, 9], FURUTA: [7, 8]},
        **{SHIP_ROLL: [1, 2], BEAD_ON_HOOP: [1], ELASTIC_JOINT: [4, 5], QUARTER_CAR: [5, 6, 7]},
        ROTATIONAL_ACTUATOR: [6, 7],
    }
    return slots[kind]


@njit(cache=True)
def _chain(p, q, v, mass, bias, drag, grad):
    n = len(q)
    g = p[1 + 5 * n]
    # cosine, sine, rate and carried mass of every link
    link = np.empty((4, n))
    angle, rate = 0.0, 0.0
    for i in range(n):
        angle += q[i]
        rate += v[i]
        link[0, i], link[1, i], link[2, i] = np.cos(angle), np.sin(angle), rate * rate
    carried = 0.0
    for i in range(n - 1, -1, -1):
        carried += p[1 + i]
        link[3, i] = carried
    for i in range(n):
        bias[i] = 0.0
        grad[i] = link[3, i] * g * p[1 + n + i] * link[1, i]
        drag[i] = p[1 + 4 * n + i] * v[i]
    for i in range(n):
        mass[i, i] = p[1 + 2 * n + i] + link[3, i] * p[1 + n + i] ** 2
        for j in range(i):
            arm = link[3, i] * p[1 + n + i] * p[1 + n + j]
            mass[i, j] = arm * (link[0, i] * link[0, j] + link[1, i] * link[1, j])
            mass[j, i] = mass[i, j]
            sine = arm * (link[1, i] * link[0, j] - link[0, i] * link[1, j])
            bias[i] += sine * link[2, j]
            bias[j] -= sine * link[2, i]
    # from angles of links to angles of joints: everything below moves along
    for i in range(n - 2, -1, -1):
        bias[i] += bias[i + 1]
        grad[i] += grad[i + 1]
        for j in range(n):
            mass[i, j] += mass[i + 1, j]
    for j in range(n - 2, -1, -1):
        for i in range(n):
            mass[i, j] += mass[i, j + 1]
    for i in range(n):
        grad[i] += p[1 + 3 * n + i] * q[i]


@njit(cache=True)
def terms(kind, p, q, v, mass, bias, drag, grad):
    """Fill inertia (d, d) and, each (d,), centrifugal force, damping force and gradient of the potential."""
    if kind == CHAIN:
        _chain(p, q, v, mass, bias, drag, grad)
    elif kind == ROCKER:
        mass[0, 0] = p[0] * (1.0 + p[1] * (1.0 - np.cos(q[0])))
        bias[0] = 0.5 * p[0] * p[1] * np.sin(q[0]) * v[0] * v[0]
        drag[0] = p[2] * v[0]
        grad[0] = p[3] * np.sin(q[0])
    elif kind == CART:
        mass[0, 0] = p[0]
        bias[0] = 0.0
        drag[0] = p[1] * v[0]
        grad[0] = p[2] * q[0] + p[3] * q[0] ** 3
    elif kind == CART_POLE:
        cart_pole(p, q, v, mass, bias, drag, grad)
    elif kind == ACROBOT:
        acrobot(p, q, v, mass, bias, drag, grad)
    elif kind == FURUTA:
        furuta(p, q, v, mass, bias, drag, grad)
    elif kind == SHIP_ROLL:
        ship_roll(p, q, v, mass, bias, drag, grad)
    elif kind == BEAD_ON_HOOP:
        bead_on_hoop(p, q, v, mass, bias, drag, grad)
    elif kind == ELASTIC_JOINT:
        elastic_joint(p, q, v, mass, bias, drag, grad)
    elif kind == QUARTER_CAR:
        quarter_car(p, q, v, mass, bias, drag, grad)
    elif kind == ROTATIONAL_ACTUATOR:
        rotational_actuator(p, q, v, mass, bias, drag, grad)
    else:
        m, g, k, length = p[0], p[1], p[2], p[3]
        reach = length + q[1]
        mass[0, 0] = m * reach * reach
        mass[0, 1] = 0.0
        mass[1, 0] = 0.0
        mass[1, 1] = m
        bias[0] = 2.0 * m * reach * v[0] * v[1]
        bias[1] = -m * reach * v[0] * v[0]
        drag[0] = p[4] * v[0]
        drag[1] = p[5] * v[1]
        grad[0] = m * g * reach * np.sin(q[0])
        grad[1] = k * q[1] + m * g * (1.0 - np.cos(q[0]))


def draw_spread(rng: np.random.Generator, value: float, share: float) -> float:
    """``value`` times a factor that is log-uniform between ``exp(-share)`` and ``exp(share)``."""
    return float(value * np.exp(rng.uniform(-share, share)))


def _pendulum(rng: np.random.Generator) -> Mechanism:
    mass, length = draw_spread(rng, 0.6, 0.6), draw_spread(rng, 0.28, 0.3)
    inertia = mass * length**2 * rng.uniform(0.0, 0.3)
    total = mass * length**2 + inertia
    omega = np.sqrt(9.81 * mass * length / total)
    c = 2.0 * rng.uniform(0.008, 0.04) * omega * total
    p = np.array([1.0, mass, length, inertia, 0.0, c, 9.81])
    return Mechanism("pendulum", CHAIN, 1, p, np.array([[1.0]]), np.array([rng.uniform(0.5, 1.0)]))


def _rocker(rng: np.random.Generator) -> Mechanism:
    inertia, omega = draw_spread(rng, 0.05, 0.7), 2.0 * np.pi * rng.uniform(0.75, 1.4)
    c = 2.0 * rng.uniform(0.008, 0.04) * omega * inertia
    p = np.array([inertia, rng.uniform(0.5, 2.0), c, inertia * omega**2])
    return Mechanism("rocker", ROCKER, 1, p, np.array([[1.0]]), np.array([rng.uniform(0.3, 0.7)]))


def _cart(rng: np.random.Generator, *, cubic: bool) -> Mechanism:
    mass, omega = draw_spread(rng, 0.8, 0.7), 2.0 * np.pi * rng.uniform(0.7, 1.4)
    size = draw_spread(rng, 0.12, 0.7)
    c = 2.0 * rng.uniform(0.01, 0.05) * omega * mass
    k = mass * omega**2
    k3 = k * rng.uniform(0.15, 0.6) / size**2 if cubic else 0.0
    p = np.array([mass, c, k, k3])
    name = "duffing_cart" if cubic else "linear_cart"
    return Mechanism(name, CART, 1, p, np.array([[1.0]]), np.array([size]))


def _two_link(rng: np.random.Generator) -> Mechanism:
    masses = np.array([draw_spread(rng, 0.8, 0.3), draw_spread(rng, 0.4, 0.3)])
    lengths = np.array([draw_spread(rng, 0.22, 0.2), draw_spread(rng, 0.16, 0.2)])
    springs = np.array([rng.uniform(0.0, 0.5), rng.uniform(0.0, 0.2)])
    inertia = 0.1 * masses * lengths**2
    reference = np.array([(masses.sum()) * lengths.sum() ** 2, masses[1] * lengths[1] ** 2])
    c = 2.0 * rng.uniform(0.01, 0.03, 2) * 6.0 * reference
    p = np.concatenate([[2.0], masses, lengths, inertia, springs, c, [9.81]])
    b = np.diag(reference / reference[0])
    size = np.array([rng.uniform(0.2, 0.4), rng.uniform(0.25, 0.5)])
    return Mechanism("two_link", CHAIN, 2, p, b, size)


def _bag(rng: np.random.Generator) -> Mechanism:
    mass, length = draw_spread(rng, 2.0, 0.5), draw_spread(rng, 0.35, 0.3)
    swing = np.sqrt(9.81 / length)
    bounce = swing * (rng.uniform(1.45, 1.75) if rng.random() < 0.5 else rng.uniform(2.4, 3.0))
    c = 2.0 * rng.uniform(0.01, 0.04, 2) * np.array([swing * mass * length**2, bounce * mass])
    p = np.array([mass, 9.81, mass * bounce**2, length, c[0], c[1]])
    size = np.array([rng.uniform(0.2, 0.4), length * rng.uniform(0.04, 0.1)])
    return Mechanism("bag", BAG, 2, p, np.diag([length, 1.0]), size)


def _soft_robot(rng: np.random.Generator) -> Mechanism:
    masses = np.array([draw_spread(rng, 0.06, 0.2) for _ in range(4)])
    lengths = np.array([draw_spread(rng, 0.07, 0.1) for _ in range(4)])
    inertia = 0.3 * masses * lengths**2
    hanging = np.array([masses[i:].sum() * lengths[i:].sum() ** 2 / 2.0 for i in range(4)])
    springs = hanging * (2.0 * np.pi * rng.uniform(0.8, 1.1)) ** 2 * np.array([1.0, 1.2, 1.5, 2.0])
    c = 2.0 * rng.uniform(0.04, 0.1, 4) * 2.0 * np.pi * hanging
    p = np.concatenate([[4.0], masses, lengths, inertia, springs, c, [9.81]])
    share = rng.uniform(0.8, 1.2, 4) * springs / springs[0]
    b = np.zeros((4, 4))
    b[:2, 0], b[:2, 1], b[2:, 2], b[2:, 3] = share[:2], -share[:2], share[2:], -share[2:]
    return Mechanism("soft_robot", CHAIN, 4, p, b, rng.uniform(0.15, 0.3, 4))


def _inputs_of(rng: np.random.Generator, reference: Array, first: int) -> Array:
    """Input matrix (2, n_u): both coordinates driven, or, as the authors have it, ``first`` alone."""
    b = np.diag(reference / reference[0])
    return b if rng.random() < 0.5 else np.ascontiguousarray(b[:, [first]] / b[first, first])


def _cart_pole(rng: np.random.Generator) -> Mechanism:
    cart, pole, half = draw_spread(rng, 1.0, 0.4), draw_spread(rng, 0.25, 0.6), draw_spread(rng, 0.25, 0.4)
    swing = np.sqrt(0.75 * 9.81 / half)
    k = (cart + pole) * (swing * rng.uniform(0.6, 1.5)) ** 2
    inertia = np.array([cart + pole, 4.0 / 3.0 * pole * half**2])
    c = 2.0 * rng.uniform(0.008, 0.04, 2) * swing * inertia
    p = np.array([cart, pole, half, 9.81, k, *c])
    size = np.array([half * rng.uniform(0.2, 0.5), rng.uniform(0.25, 0.6)])
    b = _inputs_of(rng, np.array([1.0, half * pole / (cart + pole)]), 0)
    return Mechanism("cart_pole", CART_POLE, 2, p, b, size)


def _acrobot(rng: np.random.Generator) -> Mechanism:
    m1, m2 = draw_spread(rng, 1.0, 0.3), draw_spread(rng, 0.8, 0.4)
    l1, l2 = draw_spread(rng, 0.4, 0.4), draw_spread(rng, 0.4, 0.4)
    # of slender links to twice that
    share = rng.uniform(1.0 / 12.0, 1.0 / 6.0)
    inertia = np.array([m1 * l1**2, m2 * l2**2]) * share
    whole = np.array([(m1 + m2) * (l1 + l2) ** 2 / 3.0, m2 * l2**2 / 3.0])
    c = 2.0 * rng.uniform(0.01, 0.04, 2) * np.sqrt(9.81 / (l1 + l2)) * whole
    p = np.array([m1, m2, l1, 0.5 * l1, 0.5 * l2, *inertia, 9.81, *c])
    size = np.array([rng.uniform(0.2, 0.45), rng.uniform(0.25, 0.6)])
    return Mechanism("acrobot", ACROBOT, 2, p, _inputs_of(rng, whole, 1), size)


def _furuta(rng: np.random.Generator) -> Mechanism:
    mass, arm, half = draw_spread(rng, 0.1, 0.5), draw_spread(rng, 0.2, 0.3), draw_spread(rng, 0.15, 0.3)
    swing = mass * half**2 * rng.uniform(1.1, 1.4)
    own = mass * arm**2 * rng.uniform(0.5, 2.0)
    whole = np.array([own + mass * arm**2, swing])
    omega = np.sqrt(mass * 9.81 * half / swing)
    k = whole[0] * (omega * rng.uniform(0.6, 1.3)) ** 2
    c = 2.0 * rng.uniform(0.01, 0.04, 2) * omega * whole
    p = np.array([own, mass, arm, half, swing, 9.81, k, *c])
    size = np.array([rng.uniform(0.2, 0.5), rng.uniform(0.25, 0.6)])
    return Mechanism("furuta", FURUTA, 2, p, _inputs_of(rng, whole, 0), size)


def _ship_roll(rng: np.random.Generator) -> Mechanism:
    inertia, omega = draw_spread(rng, 0.4, 0.7), 2.0 * np.pi * rng.uniform(0.4, 1.1)
    size = rng.uniform(0.25, 0.6)
    k = inertia * omega**2
    c = 2.0 * rng.uniform(0.005, 0.03) * omega * inertia
    drag = c * rng.uniform(0.2, 1.0) / (size * omega)
    p = np.array(
        [inertia, c, drag, k, k * rng.uniform(0.1, 0.5) / size**2, k * rng.uniform(0.0, 0.2) / size**4]
    )
    return Mechanism("ship_roll", SHIP_ROLL, 1, p, np.array([[1.0]]), np.array([size]))


def _bead_on_hoop(rng: np.random.Generator) -> Mechanism:
    inertia, fall = draw_spread(rng, 0.02, 0.7), 9.81 / draw_spread(rng, 0.15, 0.5)
    turning = fall * rng.uniform(0.2, 0.7)
    c = 2.0 * rng.uniform(0.008, 0.04) * np.sqrt(fall - turning) * inertia
    p = np.array([inertia, c, fall, turning])
    return Mechanism("bead_on_hoop", BEAD_ON_HOOP, 1, p, np.array([[1.0]]), np.array([rng.uniform(0.3, 0.8)]))


def _elastic_joint(rng: np.random.Generator) -> Mechanism:
    link, omega = draw_spread(rng, 0.1, 0.6), 2.0 * np.pi * rng.uniform(0.6, 1.2)
    motor = link * rng.uniform(0.3, 1.5)
    weight = (link + motor) * omega**2
    k = weight * rng.uniform(1.5, 5.0)
    c = 2.0 * rng.uniform(0.01, 0.04, 2) * omega * np.array([link, motor])
    p = np.array([link, weight, k, motor, *c])
    size = rng.uniform(0.25, 0.6) * np.array([1.0, rng.uniform(1.0, 1.3)])
    return Mechanism("elastic_joint", ELASTIC_JOINT, 2, p, _inputs_of(rng, np.array([link, motor]), 1), size)


def _quarter_car(rng: np.random.Generator) -> Mechanism:
    body, omega = draw_spread(rng, 3.0, 0.6), 2.0 * np.pi * rng.uniform(0.7, 1.4)
    wheel, size = body * rng.uniform(0.2, 0.6), draw_spread(rng, 0.05, 0.5)
    k = body * omega**2
    tyre = k * rng.uniform(1.5, 4.0)
    c = 2.0 * rng.uniform(0.01, 0.05, 3) * omega * np.array([body, body, wheel])
    p = np.array([body, wheel, k, k * rng.uniform(0.0, 0.4) / size**2, tyre, *c])
    # the actuator of an active suspension acts between body and wheel
    b = np.diag([1.0, wheel / body]) if rng.random() < 0.5 else np.array([[1.0], [-1.0]])
    return Mechanism("quarter_car", QUARTER_CAR, 2, p, b, size * np.array([1.0, rng.uniform(0.4, 0.7)]))


def _rotational_actuator(rng: np.random.Generator) -> Mechanism:
    cart, rotor = draw_spread(rng, 1.0, 0.5), draw_spread(rng, 0.2, 0.5)
    arm = draw_spread(rng, 0.1, 0.4)
    own = rotor * arm**2 * rng.uniform(0.2, 1.5)
    swing = np.sqrt(9.81 * rotor * arm / (own + rotor * arm**2))
    k = (cart + rotor) * (swing * rng.uniform(0.6, 1.5)) ** 2
    whole = np.array([cart + rotor, own + rotor * arm**2])
    c = 2.0 * rng.uniform(0.01, 0.04, 2) * swing * whole
    p = np.array([cart, rotor, arm, own, k, 9.81, *c])
    size = np.array([arm * rng.uniform(0.2, 0.5), rng.uniform(0.3, 0.7)])
    b = _inputs_of(rng, np.array([1.0, arm * rotor / (cart + rotor)]), 1)
    return Mechanism("rotational_actuator", ROTATIONAL_ACTUATOR, 2, p, b, size)


def draw_mechanism(system: str, rng: np.random.Generator) -> Mechanism:
    """A nominal mechanism of the named system.

    Raises:
        ValueError: if no such system exists.
    """
    if system in ("duffing_cart", "linear_cart"):
        return _cart(rng, cubic=system == "duffing_cart")
    makers = {
        "pendulum": _pendulum,
        "rocker": _rocker,
        "two_link": _two_link,
        "bag": _bag,
        "soft_robot": _soft_robot,
        "cart_pole": _cart_pole,
        "acrobot": _acrobot,
        "furuta": _furuta,
        "ship_roll": _ship_roll,
        "bead_on_hoop": _bead_on_hoop,
        "elastic_joint": _elastic_joint,
        "quarter_car": _quarter_car,
        "rotational_actuator": _rotational_actuator,
    }
    if system not in makers:
        raise ValueError(f"system {system!r}: none such; choose from {sorted(makers)} and the two carts")
    return makers[system](rng)
