"""Where a force lies that was put in on purpose, and that none is found where none was."""

import numpy as np
import pytest

from lagsplat.diagnose.mechanics.model import compute_rest_frequencies_hz
from lagsplat.diagnose.residual.localization import ResidualLocation, locate
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.mechanisms import Chain, Duffing, TwoLink, film


def inputs(t):
    return np.sin(2.3 * t) + 0.5 * np.sin(8.2 * t + 1) + 0.6 * np.sin(5.2 * t)


def located(mechanism, motions, **options) -> ResidualLocation:
    """Where the gap lies, with the natural period of the slowest mode at rest."""
    scale = np.std(np.concatenate([motion.q for motion in motions]), axis=0)
    period_s = float(1.0 / compute_rest_frequencies_hz(mechanism, scale)[0])
    return locate(mechanism, motions, period_s=period_s, **options)


def looked(force, *, forced: bool = True, seconds: float = 16.0, **kinds) -> ResidualLocation:
    mechanism = Duffing(n_u=int(forced))
    motion = film(
        mechanism, seconds, force=force, inputs=inputs if forced else None, noise=0.01, finer=2, **kinds
    )
    return located(mechanism, [motion])


def friction(t, q, v, u):
    return -2.0 * np.tanh(v / 0.05)


def quiet(t, q, v, u):
    return np.zeros(1)


def test_a_push_has_its_time():
    file, start, end, share = looked(lambda t, q, v, u: np.array([6.0 * (5.0 < t < 5.5)])).time_s[0]
    assert (file, start, end) == ("film 0", pytest.approx(5.0, abs=0.1), pytest.approx(5.5, abs=0.1))
    assert share > 0.9


def test_a_hum_has_its_frequency():
    found = looked(lambda t, q, v, u: np.array([1.5 * np.sin(2 * np.pi * 2.3 * t)]), forced=False)
    low, high, share = found.frequency_hz[0]
    assert low < 2.3 < high
    assert share > 0.8
    assert found.spectrum.lines[0].frequency_hz == pytest.approx(2.3, abs=0.03)


def test_a_stop_has_its_place():
    found = looked(lambda t, q, v, u: -2000.0 * np.maximum(q - 0.3, 0.0))
    box = found.state_region["q0"][0]
    assert 0.1 < box["position"][0] < 0.32
    assert box["share"] > 0.9
    assert box["mean"] < 0.0


def test_friction_of_one_joint_lies_in_that_joint():
    def one_joint(t, q, v, u):
        return np.array([0.0, -0.05 * np.tanh(v[1] / 0.02)])

    motion = film(TwoLink(), 12.0, start=(0.3, 0.4), force=one_joint, noise=0.005, finer=4)
    found = located(TwoLink(), [motion])
    assert found.coordinates["q1"] > 0.9


@pytest.mark.parametrize("forced", [True, False])
def test_a_perfect_sim_has_no_place(forced):
    mechanism = Duffing(n_u=int(forced))
    base = film(mechanism, 8.0, inputs=inputs if forced else None, finer=2)
    told = 0
    for seed in range(24):
        noise = 0.02 * base.q.std() * np.random.default_rng(seed).standard_normal(base.q.shape)
        found = located(mechanism, [Trajectory(time_s=base.time_s, q=base.q + noise, u=base.u)])
        told += bool(found.time_s or found.state_region or found.frequency_hz)
    assert told <= 3  # 1 in 100, given four chances to speak


def test_shift_of_the_clock_and_units_change_nothing():
    motion = film(Duffing(n_u=0), 10.0, force=friction, noise=0.01, finer=2)
    later = Trajectory(time_s=motion.time_s + 1000.0, q=motion.q, u=motion.u)
    one, two = (located(Duffing(n_u=0), [each]) for each in (motion, later))
    assert two.time_s[0][1] - one.time_s[0][1] == pytest.approx(1000.0, abs=1e-6)
    finer = Duffing(n_u=0, hard=20.0 / 100.0**2)  # the same thing in hundredths
    small = located(finer, [Trajectory(time_s=motion.time_s, q=100.0 * motion.q, u=motion.u)])
    assert small.time_s[0][3] == pytest.approx(one.time_s[0][3], abs=0.02)


def test_four_coordinates_two_files_and_cuts():
    def pull(t, q, v, u):
        return np.array([0.0, 0.0, -3.0 * np.tanh(v[2] / 0.05), 0.0])

    motions = [
        film(Chain(), 10.0, start=(0.3, s, 0.1, 0.4), force=pull, noise=0.01, finer=2, seed=seed)
        for seed, s in enumerate((0.2, -0.3))
    ]
    motions[1] = motions[1].cut([240])
    found = located(Chain(), motions)
    assert found.coordinates["q2"] > 0.9
    assert {event[0] for event in found.time_s} == {"film 0", "film 1"}
