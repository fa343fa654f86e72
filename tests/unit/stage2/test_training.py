"""Rollback of exploding steps, and the validation score."""

import math

import numpy as np
import pytest
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.fit import SHORTENED, BestCheckpoint, StepRollback, draw_validation_task
from lagsplat.stage2.rollout import rollout
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
    score = validation.score(lagrangian)
    assert score < 0.02
    best = BestCheckpoint()
    best.consider(lagrangian, score)
    kept = lagrangian.rest.detach().clone()
    with torch.no_grad():
        lagrangian.rest.fill_(torch.nan)
    worse = validation.score(lagrangian)
    assert worse == float("inf")
    best.consider(lagrangian, worse)
    assert best.rejected == 1
    best.restore(lagrangian)
    assert torch.equal(lagrangian.rest.detach(), kept)
