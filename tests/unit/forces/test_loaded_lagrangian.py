"""Edits and loads that make no sense."""

import math

import pytest
import torch

from lagsplat.forces.loaded_lagrangian import LoadedLagrangian
from lagsplat.forces.loads import ConstantLoad
from lagsplat.stage2.lagrangian import LawEdits
from tests.stage2_problems import random_lagrangian


@pytest.mark.parametrize(
    "changes", [{"inertia": 0.0}, {"stiffness": -1.0}, {"damping": -0.1}, {"inertia": math.inf}]
)
def test_edits_outside_their_domain_are_refused(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        LawEdits(**changes)


def test_zero_damping_is_a_valid_edit():
    assert LawEdits(damping=0.0).damping == 0.0


def test_a_loaded_law_shares_the_parameters_and_does_not_change_the_law():
    law = random_lagrangian(2, 1, 0)
    q, u = torch.zeros(1, 2, dtype=torch.float64), torch.ones(1, 1, dtype=torch.float64)
    before = law.conservative_force(q, u, law.prepare())
    loaded = LoadedLagrangian(law, ConstantLoad(torch.ones(1, 2, dtype=torch.float64)))
    assert loaded.rest is law.rest
    torch.testing.assert_close(loaded.conservative_force(q, u, law.prepare()), before + 1.0)
    torch.testing.assert_close(law.conservative_force(q, u, law.prepare()), before)
    with pytest.raises(ValueError, match="not finite"):
        ConstantLoad(torch.tensor([[math.inf, 0.0]]))
