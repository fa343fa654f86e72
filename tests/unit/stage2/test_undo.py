"""What happens when a descent steps over the edge."""

import math

import pytest
import torch

from lagsplat.stage2.training import SHORTENED, StepRollback


@pytest.fixture
def parameter():
    return torch.tensor([1.0])


@pytest.mark.parametrize("bad", [100.0, math.inf, math.nan])
def test_a_step_that_explodes_is_taken_back_and_later_ones_are_shorter(parameter, bad):
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


def test_it_goes_back_to_recent_parameters(parameter):
    rollback = StepRollback([parameter])
    for step in range(25):
        parameter.fill_(float(step))
        rollback.accept(1.0)
    rollback.accept(math.nan)
    assert parameter.item() == 20.0


def test_a_start_that_has_no_finite_loss_stays_where_it_is(parameter):
    rollback = StepRollback([parameter])
    assert not rollback.accept(math.inf)
    assert parameter.item() == 1.0
