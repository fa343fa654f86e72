"""Windows in which a fitted law was never seen, or leaves what it was fitted in, are not judged."""

from dataclasses import replace

import numpy as np

from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.identification.novelty import KnownRegion
from lagsplat.diagnose.inference.problem import EstimationProblem, build_problem
from tests.unit.diagnose.toys import film, oscillator, settings

DECAYING = film(seconds=30.0, start=(1.0, 0.0))


def bench(radius: float, *, hard: float = 6.0) -> EstimationProblem:
    region = KnownRegion(np.zeros(1), radius, room=0.25)
    sim = replace(EstimatedSimulator.exact(oscillator(n_u=0, hard=hard)), known_region=region)
    return build_problem(sim, [DECAYING], settings())


def test_what_lies_within_the_region_is_all_kept():
    assert bench(1.5).excluded_windows == 0


def test_windows_that_are_recorded_outside_are_left_out():
    problem = bench(0.8)
    assert problem.excluded_windows > 0
    assert np.abs(problem.windows.take(problem.dataset.smooth)).max() <= 0.8 * 1.125


def test_windows_that_the_law_leaves_are_left_out():
    """A quartic that bends down carries the first window over its top, which lies outside the region."""
    problem = bench(1.05, hard=-41.0)
    predicted = problem.predict(())(
        np.zeros((1, problem.rollout_model.nuisance.size)), problem.initial_states[None]
    )
    assert problem.excluded_windows > 0
    assert np.abs(predicted).max() < 1.05 * 1.25


def test_a_recording_that_is_mostly_outside_is_judged_whole():
    assert bench(0.01).excluded_windows == 0


def test_distances_are_shares_of_the_radius():
    region = KnownRegion(np.array([1.0, 0.0]), 2.0, room=0.25)
    np.testing.assert_allclose(region.measure_distance(np.array([[1.0, 0.0], [1.0, 3.0]])), [0.0, 1.5])
    moved = replace(region, radius=1.0)
    np.testing.assert_allclose(moved.measure_distance(np.array([[[2.0, 0.0]]])), [[1.0]])
