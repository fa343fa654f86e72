"""Mechanics of the generated motions, against energy, closed forms and another integrator."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.gapgen import laws
from benchmarks.gapgen.effect import Effect
from benchmarks.gapgen.inputs import through_actuator
from benchmarks.gapgen.mechanisms import CART, Mechanism, draw_mechanism, terms
from benchmarks.gapgen.motion import Plan, World

SYSTEMS = (
    "pendulum",
    "rocker",
    "duffing_cart",
    "two_link",
    "bag",
    "soft_robot",
    "cart_pole",
    "acrobot",
    "furuta",
)


def cart(*, c: float = 0.0, k: float = 40.0) -> Mechanism:
    return Mechanism("linear_cart", CART, 1, np.array([1.0, c, k, 0.0]), np.array([[1.0]]), np.array([0.2]))


def free(x0: list[float], n: int, dt: float = 0.01) -> Plan:
    return Plan(dt, [0.0], [np.array(x0)], [0], [np.zeros((n, 1))])


def of(law: int, numbers: list[float]) -> list[Effect]:
    return [Effect("any", [(law, 0, 0, numbers)])]


def parts(m: Mechanism, q: Any, v: Any) -> list[Any]:
    out = [np.zeros((m.d, m.d)), np.zeros(m.d), np.zeros(m.d), np.zeros(m.d)]
    terms(m.kind, m.p, q, v, *out)
    return out


@pytest.mark.parametrize("system", SYSTEMS)
def test_centrifugal_forces_follow_from_the_inertia(system: str) -> None:
    rng = np.random.default_rng(1)
    m = draw_mechanism(system, rng)
    q, v = rng.normal(size=m.d) * m.size, rng.normal(size=m.d)
    h = 1e-6
    change = [(parts(m, q + h * e, v)[0] - parts(m, q - h * e, v)[0]) / (2 * h) for e in np.eye(m.d)]
    rate = sum(v[k] * change[k] for k in range(m.d))
    expected = rate @ v - 0.5 * np.array([v @ one @ v for one in change])
    mass, bias, _, _ = parts(m, q, v)
    assert np.allclose(mass, mass.T)
    assert np.all(np.linalg.eigvalsh(mass) > 0)
    assert np.allclose(bias, expected, atol=1e-6 * np.abs(mass).max())


@pytest.mark.parametrize("system", SYSTEMS)
def test_motion_agrees_with_an_adaptive_integrator(system: str) -> None:
    m = draw_mechanism(system, np.random.default_rng(2))
    x0 = np.concatenate([0.7 * m.size, np.zeros(m.d)])

    def rate(_: float, x: Any) -> Any:
        mass, bias, drag, grad = parts(m, x[: m.d], x[m.d :])
        return np.concatenate([x[m.d :], np.linalg.solve(mass, -bias - drag - grad)])

    plan = Plan(0.02, [0.0], [x0], [0], [np.zeros((151, m.n_u))])
    found = World(m).move(plan)[0].x
    true = solve_ivp(rate, (0.0, 3.0), x0, t_eval=np.arange(151) * 0.02, rtol=1e-10, atol=1e-12).y.T
    assert np.abs(found - true)[:, : m.d].max() < 1e-5 * m.size.max()


def test_dry_friction_takes_as_much_in_every_swing_and_then_holds() -> None:
    level, k = 0.5, 40.0
    x = World(cart(k=k), of(laws.FRICTION, [level, level, 1.0, 0.0, 1.0])).move(free([0.2, 0.0], 1200))[0].x
    turns = np.flatnonzero((x[1:-1, 0] - x[:-2, 0]) * (x[2:, 0] - x[1:-1, 0]) < 0) + 1
    heights = np.abs(x[turns, 0])
    expected = 0.2 - 2.0 * level / k * np.arange(1, len(heights) + 1)
    # turning points fall between samples
    assert np.abs(heights[:5] - expected[:5]).max() < 2e-3
    assert np.ptp(x[-100:, 0]) < 1e-9
    assert abs(x[-1, 0]) * k < level


def test_a_bristle_and_set_valued_friction_agree_in_the_large() -> None:
    level = 0.5
    rigid = [level, level, 1.0, 0.0, 1.0]
    soft = [*rigid, 0.0, 3e-4, 0.6 * np.sqrt(level / 3e-4)]
    a = World(cart(), of(laws.FRICTION, rigid)).move(free([0.2, 0.0], 500))[0].x[:, 0]
    b = World(cart(), of(laws.BRISTLE, soft)).move(free([0.2, 0.0], 500))[0].x[:, 0]
    assert np.abs(a - b).max() < 4e-3


@pytest.mark.parametrize(
    ("law", "numbers"),
    [
        (laws.VISCOUS, [0.3, 1.03, 0.5]),
        (laws.DRAG, [2.0, 2.2, 0.5]),
        (laws.FRICTION, [0.3, 0.6, 0.1, 1.0, 4.0]),
        (laws.BRISTLE, [0.3, 0.6, 0.1, 1.0, 4.0, 0.0, 2e-3, 8.0]),
        (laws.SLIP_CHAIN, [0.4, 0.05]),
        (laws.LOCAL_DAMPING, [2.0, 0.05, 0.05]),
        (laws.ONE_WAY, [1.0, -1.0]),
    ],
)
def test_dissipative_laws_take_energy(law: int, numbers: list[float]) -> None:
    # from the middle, where no spring of a law is stretched
    x = World(cart(), of(law, numbers)).move(free([0.0, 1.2], 400))[0].x
    energy = 0.5 * x[:, 1] ** 2 + 20.0 * x[:, 0] ** 2
    peaks = energy.reshape(4, 100).max(1)
    assert energy[-1] < 0.97 * energy[0]
    # what a law stores may come back, but never more than was there
    assert energy.max() <= energy[0] * (1 + 1e-6)
    assert np.all(np.diff(peaks) <= 1e-9)


def test_contact_holds_the_cart_back() -> None:
    numbers = [1.0, 0.1, 20.0 * 40.0 / np.sqrt(0.01), 0.2]
    x = World(cart(), of(laws.STOP, numbers)).move(free([-0.2, 0.0], 400))[0].x
    assert 0.1 < x[:, 0].max() < 0.15
    assert x[:, 0].min() > -0.2 - 1e-9


def test_a_hidden_mass_keeps_energy_when_undamped() -> None:
    ratio, omega = 0.1, 9.0
    x = World(cart(), of(laws.ABSORBER, [omega, ratio, 0.0, 0.0])).move(free([0.2, 0.0], 500))[0].x
    stored = 0.5 * ratio * (x[:, 3] ** 2 + omega**2 * (x[:, 2] - x[:, 0]) ** 2)
    energy = 0.5 * x[:, 1] ** 2 + 20.0 * x[:, 0] ** 2 + stored
    assert np.ptp(energy) < 1e-4 * energy[0]


def test_actuators_do_what_they_are_called() -> None:
    t = np.arange(4000) * 1e-3
    u = np.sin(2 * np.pi * t)
    late = through_actuator(u, "shift", {"seconds": 0.1, "phase": 0.0}, 1e-3)
    assert np.abs(late[500:] - np.sin(2 * np.pi * (t[500:] - 0.1))).max() < 0.05
    dead = through_actuator(u, "dead_zone", {"half_width": 0.4}, 1e-3)
    assert np.abs(dead[np.abs(u) < 0.2]).max() < 0.02
    assert abs(dead.max() - 0.6) < 0.01
    assert np.abs(through_actuator(u, "soft_limit", {"limit": 0.5, "sharpness": 8.0}, 1e-3)).max() < 0.5
    play = through_actuator(u, "backlash", {"width": 0.4}, 1e-3)
    assert abs(play[1000:].max() - 0.8) < 1e-3
    slow = through_actuator(u, "lag", {"time_constant": 0.1}, 1e-3)
    gain = 1.0 / np.sqrt((1 + (0.085 * 2 * np.pi) ** 2) * (1 + (0.015 * 2 * np.pi) ** 2))
    assert abs(slow[1000:].max() - gain) < 2e-3
    with pytest.raises(ValueError, match="none such"):
        through_actuator(u, "magic", {}, 1e-3)
