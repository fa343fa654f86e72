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
    undo = StepRollback([parameter])
    assert undo.accepts(1.0)
    parameter.fill_(7.0)
    assert not undo.accepts(bad)
    assert parameter.item() == 1.0
    assert undo.shortening == pytest.approx(SHORTENED)
    assert undo.taken_back == 1


def test_losses_that_scatter_or_fall_are_accepted(parameter):
    undo = StepRollback([parameter])
    assert all(undo.accepts(loss) for loss in (1.0, 2.0, 0.5, 1.5, 0.1, 0.3))
    assert undo.shortening == 1.0


def test_it_goes_back_to_recent_parameters(parameter):
    undo = StepRollback([parameter])
    for step in range(25):
        parameter.fill_(float(step))
        undo.accepts(1.0)
    undo.accepts(math.nan)
    assert parameter.item() == 20.0


def test_a_start_that_has_no_finite_loss_stays_where_it_is(parameter):
    undo = StepRollback([parameter])
    assert not undo.accepts(math.inf)
    assert parameter.item() == 1.0
