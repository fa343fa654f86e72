"""What a learned law misses of its own recordings is no gap."""

from dataclasses import replace

import numpy as np

from lagsplat.diagnose.diagnosis import LAWLESS, diagnose
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.holdout import forecast_holdout
from lagsplat.diagnose.inference.problem import HypothesisFit, build_problem
from lagsplat.diagnose.inference.recalibration import (
    calibrate_misfit,
    choose_null_windows,
    separate_own_error,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.toys import film, oscillator, settings, wave


def record(seed: int) -> Trajectory:
    return film(seconds=40.0, noise=0.01, seed=seed, u=wave(seed))


def separate(hard: float) -> EstimatedSimulator:
    """A sim whose spring hardens by ``hard`` instead of 6, beside a recording of the true one."""
    sim = calibrate_misfit(EstimatedSimulator.exact(oscillator(hard=hard)), [record(0)], settings())
    return separate_own_error(sim, choose_null_windows(sim, record(0), [record(2)], settings()))


def test_a_true_law_has_hardly_an_error_of_its_own():
    noise = 0.01 * record(0).q.std()
    assert np.all(np.sqrt(separate(6.0).own_error) < noise)


def test_the_error_of_a_wrong_law_counts_as_noise():
    raw = calibrate_misfit(EstimatedSimulator.exact(oscillator(hard=30.0)), [record(0)], settings())
    sim = separate(30.0)
    assert raw.misfit > 3.0
    assert 0.3 < sim.misfit < 2.0


def test_another_recording_without_an_effect_has_no_gap():
    """The same wrong law is three times its noise off, and its forecasts no more than their floor."""
    sim = separate(30.0)
    problem = build_problem(sim, [record(2)], settings())
    none = HypothesisFit((), problem.fit((), np.zeros(problem.rollout_model.nuisance.size)))
    assert none.fit.misfit / problem.degrees_of_freedom < 2.0
    ratio = forecast_holdout(problem, none, none, given=sim.model).refit_over_floor
    assert ratio.value is not None
    assert ratio.value < 1.3


def test_a_sim_that_lacks_nothing_is_judged_by_noise_alone():
    problem = build_problem(EstimatedSimulator.exact(oscillator()), [record(2)], settings())
    np.testing.assert_array_equal(problem.deviation, problem.sigma)


def test_a_law_that_misses_most_of_its_own_motion_says_nothing():
    real = film(noise=0.01, u=wave(2))
    sim = replace(EstimatedSimulator.exact(oscillator()), own_error=0.6 * np.var(real.q, axis=0))
    config = replace(settings(), families=1, always_fitted=[])
    assert LAWLESS in diagnose(sim, [real], config).diagnosis.checks["undetermined"]
