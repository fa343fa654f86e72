"""Rollback of exploding steps, and the validation score."""

import math

import numpy as np
import pytest
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.fit import SHORTENED, BestCheckpoint, StepRollback
from lagsplat.stage2.rollout import rollout
from lagsplat.stage2.validation import ForecastErrors, draw_validation_task
from tests.stage2_problems import random_lagrangian


@pytest.fixture
def parameter():
    return torch.tensor([1.0])


@pytest.mark.parametrize("bad", [100.0, math.inf, math.nan])
def test_a_step_that_explodes_is_rolled_back_and_later_steps_are_shorter(parameter, bad):
    rollback = StepRollback([parameter])
    assert rollback.accept(1.0)
    parameter.fill_(7.0)
    assert not rollback.accept(bad)
    assert parameter.item() == 1.0
    assert rollback.rate_factor == pytest.approx(SHORTENED)
    assert rollback.rollbacks == 1


def test_losses_that_scatter_or_fall_are_accepted(parameter):
    rollback = StepRollback([parameter])
    assert all(rollback.accept(loss) for loss in (1.0, 2.0, 0.5, 1.5, 0.1, 0.3))
    assert rollback.rate_factor == 1.0


def test_a_rollback_restores_recent_parameters(parameter):
    rollback = StepRollback([parameter])
    for step in range(25):
        parameter.fill_(float(step))
        rollback.accept(1.0)
    rollback.accept(math.nan)
    assert parameter.item() == 20.0


def test_a_start_without_a_finite_loss_is_kept(parameter):
    rollback = StepRollback([parameter])
    assert not rollback.accept(math.inf)
    assert parameter.item() == 1.0


def test_the_true_dynamics_scores_near_zero_and_a_diverging_one_infinite() -> None:
    lagrangian = random_lagrangian(1, 0, 0, amount=0.05)
    dt = 0.02 * float(lagrangian.time_unit_s)
    q = torch.full((1, 1), 1.0, dtype=torch.float64)
    path, _ = rollout(lagrangian, q, 0 * q, torch.zeros(1, 300, 0, dtype=torch.float64), dt_s=dt)
    trajectory = EncodedTrajectory(path[0].numpy(), np.zeros((300, 0)), dt * np.arange(300), ((0, 300),))
    validation = draw_validation_task(trajectory, torch.eye(1, dtype=torch.float64), starts=5, n_states=1000)
    score = validation.measure(lagrangian).score
    assert score < 0.02
    best = BestCheckpoint()
    best.consider(lagrangian, score)
    kept = lagrangian.rest.detach().clone()
    with torch.no_grad():
        lagrangian.rest.fill_(torch.nan)
    worse = validation.measure(lagrangian).score
    assert worse == float("inf")
    best.consider(lagrangian, worse)
    assert best.rejected == 1
    best.restore(lagrangian)
    assert torch.equal(lagrangian.rest.detach(), kept)


def forecast_errors(each: np.ndarray, distinct: int) -> ForecastErrors:
    return ForecastErrors(each, distinct, np.arange(len(each)))


def test_errors_of_some_frames_are_those_of_rollouts_from_there() -> None:
    errors = ForecastErrors(np.array([1.0, 4.0, 9.0, 16.0]), 4, np.array([0, 10, 20, 30]))
    late = errors.of_frames(15, 31)
    assert (late.each.tolist(), late.distinct, late.starts.tolist()) == ([9.0, 16.0], 2, [20, 30])
    assert errors.of_frames(31, 40) is errors
    whole = ForecastErrors.join([errors.of_frames(0, 15), late])
    assert (whole.each.tolist(), whole.distinct) == (errors.each.tolist(), errors.distinct)


def test_a_law_is_worse_only_by_more_than_chance_and_more_than_a_tenth() -> None:
    rng = np.random.default_rng(0)
    errors = forecast_errors(np.exp(rng.standard_normal(60)), 20)
    larger = errors.each * np.exp(0.1 * rng.standard_normal(60))
    assert forecast_errors(1.5 * larger, 20).is_worse_than(errors)
    assert not errors.is_worse_than(forecast_errors(1.5 * larger, 20))
    assert not forecast_errors(1.1 * larger, 20).is_worse_than(errors)  # in rms by less than a tenth
    # one window of twenty makes the mean larger, and says nothing of the others
    single = errors.each * np.where(np.arange(60) < 3, 30.0, 0.99)
    assert forecast_errors(single, 20).score > 1.4 * errors.score
    assert not forecast_errors(single, 20).is_worse_than(errors)
    # unless it has gone astray
    astray = errors.each * np.where(np.arange(60) < 3, 300.0, 0.99)
    assert forecast_errors(astray, 20).is_worse_than(errors)


def test_a_law_that_diverges_once_is_worse() -> None:
    errors = forecast_errors(np.ones(8), 8)
    assert forecast_errors(np.array([*errors.each[1:], np.inf]), 8).is_worse_than(errors)
    assert not errors.is_worse_than(forecast_errors(np.array([*errors.each[1:], np.inf]), 8))


def test_a_law_is_as_good_only_if_it_is_in_small_motions_too() -> None:
    errors = forecast_errors(np.array([100.0, 1.0, 1.0, 1.0]), 4)
    assert forecast_errors(1.2 * errors.each, 4).is_as_good_as(errors)
    assert not forecast_errors(1.3 * errors.each, 4).is_as_good_as(errors)
    assert not forecast_errors(np.array([100.0, 2.0, 2.0, 2.0]), 4).is_as_good_as(errors)
    assert not forecast_errors(np.array([np.inf, 1.0, 1.0, 1.0]), 4).is_as_good_as(errors)


@pytest.mark.parametrize("seed", range(5))
def test_equally_good_laws_are_rarely_called_different(seed) -> None:
    rng = np.random.default_rng(seed)
    pairs = rng.standard_normal((200, 2, 20))
    called = [forecast_errors(np.exp(a), 20).is_worse_than(forecast_errors(np.exp(b), 20)) for a, b in pairs]
    assert np.mean(called) < 0.1
