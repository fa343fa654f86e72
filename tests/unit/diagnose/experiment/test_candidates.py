"""Proposed experiments stay within what the recordings show."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.experiment.candidates import (
    RecordedRange,
    find_equilibrium,
    limit_rate,
    propose_experiments,
)
from tests.unit.diagnose.toys import GAIN, OMEGA, contest, film, wave


@pytest.fixture(scope="module")
def record():
    problem = contest([film(u=wave(), seconds=12.0)])
    return problem.rollout_model.model, problem.dataset


def propose(model, dataset, **how):
    return [
        each for versions in propose_experiments(model, dataset, period_s=1.0, **how) for each in versions
    ]


def test_inputs_stay_within_the_recorded_amplitude_and_rate(record) -> None:
    model, dataset = record
    low, high = dataset.u.min(), dataset.u.max()
    fastest = np.abs(np.diff(dataset.u[:, 0]) / np.diff(dataset.time)).max()
    kinds = set()
    for each in propose(model, dataset):
        kinds.add(each.kind)
        assert each.u.min() >= low - 1e-12
        assert each.u.max() <= high + 1e-12
        assert np.abs(np.diff(each.u[:, 0]) / np.diff(each.time_s)).max() <= 1.001 * fastest
        assert np.allclose(np.diff(each.time_s), dataset.dt_s)
    driven = {"multisine", "switching", "steps", "chirp", "triangle", "hold"}
    assert kinds == driven | {"release", "known_payload"}


def test_what_has_no_input_is_released_from_poses_that_it_was_seen_in() -> None:
    problem = contest([film(seconds=8.0)])
    proposed = propose(problem.rollout_model.model, problem.dataset)
    assert {each.kind for each in proposed} == {"release", "known_payload"}
    starts = [each.start[0] for each in proposed]
    assert min(starts) == pytest.approx(problem.dataset.q.min())
    assert max(starts) == pytest.approx(problem.dataset.q.max())
    assert {each.payload > 0.0 for each in proposed if each.kind == "known_payload"} == {True}


def test_an_input_of_the_hypotheses_is_also_driven_alone(record) -> None:
    problem = contest([film(u=wave(), seconds=12.0)])
    two = replace(problem.dataset, u=np.repeat(problem.dataset.u, 2, axis=1))
    model = problem.rollout_model.model
    model = replace(model, input_map=np.repeat(model.input_map, 2, axis=1))
    moving = [np.ptp(each.u, axis=0) > 0.0 for each in propose(model, two, channels=[1])]
    assert {tuple(row.tolist()) for row in moving} == {(True, True), (False, True), (False, False)}


def test_it_begins_where_held_inputs_let_it_rest(record) -> None:
    model, dataset = record
    span = RecordedRange.of(dataset)
    rest = find_equilibrium(model, span, np.array([0.5]))
    assert (OMEGA**2) * rest[0] + 6.0 * rest[0] ** 3 == pytest.approx(0.5 * GAIN)
    far = replace(span, q_reach=0.01 * span.q_reach)
    assert find_equilibrium(model, far, np.array([0.5])).tolist() == model.rest.tolist()


def test_a_jump_becomes_a_ramp() -> None:
    u = np.array([[0.0], [1.0], [1.0], [1.0], [-1.0]])
    assert limit_rate(u, np.array([0.4]))[:, 0] == pytest.approx([0.0, 0.4, 0.8, 1.0, 0.6])
