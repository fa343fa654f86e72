"""Mechanisms of textbooks and those held back: the authors' own formulas, and energy."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.gapgen.mechanisms import Mechanism, damping_slots, draw_mechanism, terms
from benchmarks.gapgen.motion import Plan, World
from benchmarks.gapgen.sources import HELD_BACK, TEXTBOOK


def undamped(system: str) -> Mechanism:
    m = draw_mechanism(system, np.random.default_rng(3))
    p = m.p.copy()
    p[damping_slots(m.kind, m.d)] = 0.0
    return replace(m, p=p)


def terms_of(m: Mechanism, q: Any, v: Any) -> tuple[Any, ...]:
    work = np.zeros((m.d, m.d)), np.zeros(m.d), np.zeros(m.d), np.zeros(m.d)
    terms(m.kind, m.p, q, v, *work)
    return work


def accelerations(m: Mechanism, q: Any, v: Any, push: Any) -> Any:
    mass, bias, drag, grad = terms_of(m, q, v)
    return np.linalg.solve(mass, push - bias - drag - grad)


def test_the_cart_pole_is_that_of_barto_sutton_and_anderson() -> None:
    m = undamped("cart_pole")
    cart, pole, half, g, k = m.p[:5]
    x, v, push = 0.1, np.array([0.2, -0.7]), 0.4
    theta = np.pi + 0.5
    force = push - k * x
    temp = (force + pole * half * v[1] ** 2 * np.sin(theta)) / (cart + pole)
    turn = (g * np.sin(theta) - np.cos(theta) * temp) / (
        half * (4.0 / 3.0 - pole * np.cos(theta) ** 2 / (cart + pole))
    )
    slide = temp - pole * half * turn * np.cos(theta) / (cart + pole)
    found = accelerations(m, np.array([x, 0.5]), v, np.array([push, 0.0]))
    assert np.allclose(found, [slide, turn])


def test_the_acrobot_is_that_of_sutton_and_barto() -> None:
    m = undamped("acrobot")
    m1, m2, l1, lc1, lc2, i1, i2, g = m.p[:8]
    (a, b), (va, vb), tau = (0.3, -0.6), (0.5, 0.9), 0.2
    d1 = m1 * lc1**2 + m2 * (l1**2 + lc2**2 + 2 * l1 * lc2 * np.cos(b)) + i1 + i2
    d2 = m2 * (lc2**2 + l1 * lc2 * np.cos(b)) + i2
    phi2 = m2 * lc2 * g * np.cos(a + b - np.pi / 2)
    phi1 = -m2 * l1 * lc2 * vb**2 * np.sin(b) - 2 * m2 * l1 * lc2 * vb * va * np.sin(b)
    phi1 += (m1 * lc1 + m2 * l1) * g * np.cos(a - np.pi / 2) + phi2
    elbow = (tau + d2 / d1 * phi1 - m2 * l1 * lc2 * va**2 * np.sin(b) - phi2) / (
        m2 * lc2**2 + i2 - d2**2 / d1
    )
    shoulder = -(d2 * elbow + phi1) / d1
    found = accelerations(m, np.array([a, b]), np.array([va, vb]), np.array([0.0, tau]))
    assert np.allclose(found, [shoulder, elbow])


def test_the_rotational_actuator_is_that_of_bupp_bernstein_and_coppola() -> None:
    m = undamped("rotational_actuator")
    cart, rotor, e, own, k = m.p[:5]
    m = replace(m, p=np.array([cart, rotor, e, own, k, 0.0, 0.0, 0.0]))  # theirs lies level
    (x, theta), (_, rate), (force, torque) = q, v, push = (0.02, 0.7), (0.3, -1.1), (0.4, 0.05)
    couple = rotor * e * np.cos(theta)
    within = own + rotor * e**2
    load = force - k * x + rotor * e * rate**2 * np.sin(theta)
    slide = (within * load - couple * torque) / ((cart + rotor) * within - couple**2)
    turn = (torque - couple * slide) / within
    assert np.allclose(accelerations(m, np.array(q), np.array(v), np.array(push)), [slide, turn])


@pytest.mark.parametrize("system", [*TEXTBOOK, *HELD_BACK])
def test_energy_stays_without_damping(system: str) -> None:
    m = undamped(system)
    dt, n = 0.01 / max(m.frequencies_hz().max(), 1.0), 600
    plan = Plan(dt, [0.0], [np.array([*(0.8 * m.size), *np.zeros(m.d)])], [0], [np.zeros((n, m.n_u))])
    x = World(m).move(plan)[0].x
    found = [terms_of(m, state[: m.d], state[m.d :]) for state in x]
    kinetic = np.array(
        [0.5 * state[m.d :] @ mass @ state[m.d :] for state, (mass, *_) in zip(x, found, strict=True)]
    )
    work = np.array([grad for *_, grad in found])
    # the potential is what its gradient does along the way
    step = np.diff(x[:, : m.d], axis=0) * 0.5 * (work[1:] + work[:-1])
    potential = np.concatenate([[0.0], np.cumsum(step.sum(1))])
    assert np.ptp(kinetic + potential) < 2e-3 * np.ptp(kinetic)


@pytest.mark.parametrize("system", HELD_BACK)
def test_mechanisms_held_back_are_stable_and_damped_at_rest(system: str) -> None:
    for seed in range(20):
        m = draw_mechanism(system, np.random.default_rng(seed))
        assert np.all(np.linalg.eigvalsh(m.inertia_at_rest()) > 0.0)
        assert np.all(np.linalg.eigvalsh(m.stiffness_at_rest()) > 0.0)
        assert np.all(m.damping_at_rest() > 0.0)
        assert 0.2 < m.frequencies_hz()[0] < 4.0
