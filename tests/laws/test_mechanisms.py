"""Laws of the mechanisms that are let go: energy, inertia and forces agree with where the bodies are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from lagsplat.systems.dynamics import compute_stiffness
from lagsplat.systems.mechanism import (
    Linkage,
    Mechanism,
    Rocker,
    compute_free_modes,
    find_rest_state,
    release,
)
from lagsplat.systems.release import compute_jacobian

LINKAGE = Linkage(
    length=np.array([0.3, 0.2]),
    masses=np.array([0.5, 0.7]),
    center=np.array([0.14, 0.11]),
    inertia=np.array([3e-3, 5e-3]),
    friction=np.array([0.02, 0.01]),
    spring=np.array([0.1, 0.4]),
    gravity=9.81,
)
ROCKER = Rocker(radius=0.5, depth=0.2, body_mass=3.0, inertia=0.1, friction=0.1, gravity=9.81)
MECHANISMS: dict[str, Mechanism] = {"linkage": LINKAGE, "rocker": ROCKER}
ANGLE = st.floats(-2.0, 2.0)


def no_push(time_s: float, q: np.ndarray) -> np.ndarray:
    return np.zeros(len(q))


def energy(mechanism: Mechanism, states: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    kinetic = [0.5 * v @ mechanism.mass(q) @ v for q, v in zip(states, velocities, strict=True)]
    return np.array(kinetic) + mechanism.potential_energies(states)


@pytest.mark.parametrize("name", MECHANISMS)
@settings(max_examples=20, deadline=None)
@given(angles=st.tuples(ANGLE, ANGLE), speeds=st.tuples(ANGLE, ANGLE))
def test_power_of_the_equations_is_that_of_friction(
    name: str, angles: tuple[float, float], speeds: tuple[float, float]
) -> None:
    mechanism = MECHANISMS[name]
    d = len(mechanism.coordinates)
    q, v = np.array(angles[:d]), np.array(speeds[:d])
    a = mechanism.acceleration(q, v, np.zeros(d))
    step = 1e-5
    ahead = energy(mechanism, (q + step * v)[None], (v + step * a)[None])
    behind = energy(mechanism, (q - step * v)[None], (v - step * a)[None])
    power = (ahead - behind)[0] / (2 * step)
    assert power == pytest.approx(-v @ mechanism.damping() @ v, abs=1e-6)


@pytest.mark.parametrize("name", MECHANISMS)
def test_static_force_is_minus_the_slope_of_the_energy(name: str) -> None:
    mechanism = MECHANISMS[name]
    q = np.array([0.4, -0.7])[: len(mechanism.coordinates)]
    slope = approx_fprime(q, lambda x: mechanism.potential_energies(x[None])[0], 1e-7)
    np.testing.assert_allclose(mechanism.static_force(q), -slope, atol=1e-5)


def test_inertia_of_links_is_that_of_their_bodies() -> None:
    q, v = np.array([0.4, -0.9]), np.array([1.3, -0.6])
    kinetic = 0.0
    for body in range(2):
        point = compute_jacobian(LINKAGE, q, body, np.array([0.0, LINKAGE.center[body]])) @ v
        kinetic += 0.5 * LINKAGE.masses[body] * point @ point + 0.5 * LINKAGE.inertia[body] * v[body] ** 2
    assert 0.5 * v @ LINKAGE.mass(q) @ v == pytest.approx(kinetic, rel=1e-8)


def test_inertia_of_a_rocker_is_that_of_its_body_and_its_contact_stands_still() -> None:
    q, v = np.array([0.4]), np.array([1.3])
    velocity = compute_jacobian(ROCKER, q, 0, np.array([0.0, ROCKER.depth])) @ v
    kinetic = 0.5 * ROCKER.body_mass * velocity @ velocity + 0.5 * ROCKER.inertia * v[0] ** 2
    assert 0.5 * v @ ROCKER.mass(q) @ v == pytest.approx(kinetic, rel=1e-8)
    contact = ROCKER.radius * np.array([np.sin(q[0]), np.cos(q[0])])  # straight below, in body coordinates
    np.testing.assert_allclose(compute_jacobian(ROCKER, q, 0, contact) @ v, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", MECHANISMS)
def test_a_small_swing_shows_the_linear_modes(name: str) -> None:
    mechanism = MECHANISMS[name]
    modes = compute_free_modes(mechanism)
    d = len(mechanism.coordinates)
    time_s = np.linspace(0.0, 3.0, 400)
    states, _ = release(mechanism, 1e-4 * np.ones(d), np.zeros(d), time_s=time_s, push=no_push, rtol=1e-10)
    roots = -modes.decay_per_s + 2j * np.pi * modes.damped_hz
    basis = np.concatenate(
        [np.exp(roots * time_s[:, None]).real, np.exp(roots * time_s[:, None]).imag], axis=1
    )
    residual = states - basis @ np.linalg.lstsq(basis, states, rcond=None)[0]
    assert np.abs(residual).max() < 1e-4 * np.abs(states).max()


def test_a_point_mass_pendulum_has_the_period_of_the_textbook() -> None:
    one = np.array([1.0])
    pendulum = Linkage(0.5 * one, one, 0.5 * one, 0 * one, 0 * one, 0 * one, gravity=9.81)
    assert compute_free_modes(pendulum).natural_hz[0] == pytest.approx(np.sqrt(9.81 / 0.5) / (2 * np.pi))
    time_s = np.linspace(0.0, 10.0, 5001)
    states, _ = release(pendulum, 1.5 * one, 0 * one, time_s=time_s, push=no_push, rtol=1e-11)
    angle = states[:, 0]
    up = np.flatnonzero((angle[1:] > 0) & (angle[:-1] <= 0))
    ups = time_s[up] - angle[up] * (time_s[1] - time_s[0]) / (angle[up + 1] - angle[up])
    # Arithmetic-geometric mean: Gauss's exact period of a pendulum of any amplitude.
    x, y = 1.0, np.cos(0.75)
    for _ in range(6):
        x, y = 0.5 * (x + y), np.sqrt(x * y)
    assert np.diff(ups).mean() == pytest.approx(2 * np.pi * np.sqrt(0.5 / 9.81) / x, rel=1e-4)


@pytest.mark.parametrize("name", MECHANISMS)
def test_rest_is_where_nothing_pulls(name: str) -> None:
    mechanism = MECHANISMS[name]
    rest = find_rest_state(mechanism)
    np.testing.assert_allclose(mechanism.static_force(rest), 0.0, atol=1e-10)
    assert np.linalg.eigvalsh(compute_stiffness(mechanism.static_force, rest))[0] > 0


def test_the_work_of_a_push_is_the_energy_it_brings() -> None:
    calm = Linkage(**{**vars(LINKAGE), "friction": np.zeros(2)})
    time_s = np.linspace(0.0, 1.0, 2001)

    def push(t: float, q: np.ndarray) -> np.ndarray:
        return np.sin(np.pi * t) ** 2 * np.array([0.3, -0.1])

    states, velocities = release(calm, np.zeros(2), np.zeros(2), time_s=time_s, push=push, rtol=1e-10)
    power = [push(t, q) @ v for t, q, v in zip(time_s, states, velocities, strict=True)]
    gained = energy(calm, states[-1:], velocities[-1:])[0] - energy(calm, states[:1], velocities[:1])[0]
    assert gained == pytest.approx(np.trapezoid(power, time_s), rel=1e-5)
