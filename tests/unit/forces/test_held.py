"""A run held at its operating point."""

import numpy as np
import pytest
import torch

from lagsplat.forces.grasp import grasp_brush
from tests.unit.forces.rocking import rocking


def test_it_rests_where_the_law_does_and_knows_how_far_it_has_been():
    held = rocking()
    assert held.rest.tolist() == pytest.approx([0.0], abs=1e-9)
    assert held.reach == pytest.approx(1.0, rel=0.01)
    assert held.pictures(held.rest[None], scale=2).shape == (1, 48, 64, 3)


def test_a_force_is_as_large_as_the_answer_asks():
    held = rocking()
    grip = grasp_brush(held.kinematics, held.rest, (20.0, 12.0), radius=1.0)
    down = np.array([0.0, 1.0])
    size = held.magnitude(grip, down, share=0.5)
    q = held.settled(size * grip.pull_back(torch.from_numpy(down))[None])
    assert float((q - held.rest).norm()) == pytest.approx(0.5 * held.reach, rel=1e-3)


def test_a_force_across_the_motion_cannot_be_made_large_enough():
    held = rocking()
    grip = grasp_brush(held.kinematics, held.rest, (2.0, 2.0), radius=1.0)
    with pytest.raises(ValueError, match="moves nothing"):
        held.magnitude(grip, np.array([1.0, 0.0]), share=0.5)
