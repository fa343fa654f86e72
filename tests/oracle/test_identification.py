"""Mechanisms whose equations are known, identified from their motions: the error of the acceleration."""

import numpy as np
import pytest

from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator, estimate_simulator
from lagsplat.diagnose.inference.problem import estimate_natural_periods
from lagsplat.diagnose.mechanics.structure import shift_coefficients
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.mechanisms import Chain, Duffing, TwoLink, film
from tests.unit.diagnose.toys import settings


class Pendulum(Duffing):
    """a = -30 sin q - 0.1 v."""

    def force(self, q, v, u):
        return -30.0 * self.m * np.sin(q) - 0.1 * self.m * v


def swing(t: np.ndarray) -> np.ndarray:
    return (
        np.sin(2.0 * np.pi * 0.37 * t)
        + 0.8 * np.sin(2.0 * np.pi * 1.3 * t + 1.0)
        + 0.5 * np.sin(2.0 * np.pi * 0.83 * t)
    )


def error(mechanism, sim: EstimatedSimulator, motions: list[Trajectory]) -> float:
    """Of the acceleration where the motions went, in fractions of its rms."""
    q = np.concatenate([m.q for m in motions])[::3]
    v = np.concatenate([np.gradient(m.q, m.time_s, axis=0) for m in motions])[::3]
    u = np.concatenate([m.u for m in motions])[::3]
    true = mechanism.acceleration(q, v, u)
    return float(np.sqrt(np.mean((sim.model.acceleration(q, v, u) - true) ** 2) / np.mean(true**2)))


CASES = {
    "pendulum": (Pendulum(n_u=0), [{"start": (1.6,)}, {"start": (0.5,)}], None, 8.0),
    "duffing": (Duffing(), [{"start": (0.4,)}], lambda t: 15.0 * swing(t), 14.0),
    "two links": (TwoLink(), [{"start": (0.7, -0.5)}, {"start": (-0.3, 0.6)}], None, 6.0),
    "chain": (Chain(n_u=1), [{"start": (0.4, -0.2, 0.3, 0.1)}], lambda t: 25.0 * swing(2.3 * t), 10.0),
}


@pytest.mark.parametrize(("noise", "bound"), [(0.0, 0.01), (0.01, 0.05)])
@pytest.mark.parametrize("name", CASES)
def test_the_acceleration_is_found_where_the_motion_went(name: str, noise: float, bound: float) -> None:
    mechanism, begun, inputs, seconds = CASES[name]
    made = [film(mechanism, seconds, inputs=inputs, finer=2, **one) for one in begun]
    rng = np.random.default_rng(1)
    sigma = noise * np.concatenate([m.q for m in made]).std(axis=0)  # of one sensor, whatever the motion
    seen = [
        Trajectory(m.time_s, m.q + sigma * rng.standard_normal(m.q.shape), m.u, source=m.source) for m in made
    ]
    sim = estimate_simulator(seen, settings())
    assert error(mechanism, sim, made) < bound
    assert sim.misfit < 1.5
    if name == "duffing":
        assert estimate_natural_periods(sim.model, made)[0] == pytest.approx(1.0, rel=0.03)


def test_the_spring_is_found_where_the_motion_went_and_no_term_that_it_does_not_show() -> None:
    """Small swings tell the stiffness at rest and no hardening; large ones both."""
    mechanism = Duffing(n_u=0)
    small, large = (film(mechanism, 6.0, start=(size,), finer=2, noise=0.01) for size in (0.05, 1.2))
    told, sizes = [], []
    for motion in (small, large):
        sim = estimate_simulator([motion], settings())
        q = np.linspace(-1.0, 1.0, 21)[:, None] * np.ptp(motion.q) / 2
        stiff = -mechanism.force(q, 0 * q, np.zeros((21, 1))) / mechanism.m
        off = -sim.model.spring(q) / sim.model.mass_at(q)[:, 0] - stiff
        told.append(np.abs(off).max() / np.abs(stiff).max())
        assert np.isfinite(sim.uncertainty_directions).all()
        sizes.append(np.count_nonzero(sim.model.potential))
    assert max(told) < 0.05
    assert sizes[0] <= 3 < sizes[1]


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_law_is_not_certain_beyond_its_recordings(noise: float) -> None:
    """Of a pendulum that swung by 0.8 rad: the force there is known, and at twice as far open enough."""
    mechanism = Pendulum(n_u=0)
    sim = estimate_simulator([film(mechanism, 8.0, start=(0.8,), finer=2, noise=noise)], settings())
    q = np.array([[0.4], [0.7], [1.6]])
    true = -mechanism.force(q, 0 * q, np.zeros((3, 1)))[:, 0] / mechanism.m
    spring = -sim.model.spring(q)[:, 0] / sim.model.inertia[0, 0]
    each = [
        -shift_coefficients(sim.model, row).spring(q)[:, 0] / sim.model.inertia[0, 0] - spring
        for row in sim.uncertainty_directions
    ]
    deviation = np.sqrt(np.sum(np.square(each), axis=0))
    assert (np.abs(spring - true)[:2] < 0.02 * true[:2]).all()
    assert (deviation[:2] < 0.05 * true[:2]).all()
    assert np.abs(spring - true)[2] < 3.0 * deviation[2]
