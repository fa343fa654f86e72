"""A run held at its operating point."""

import numpy as np
import pytest
import torch

from lagsplat.forces.loads import PointLoad
from tests.unit.forces.rocking import rocking


def test_an_operating_point_rests_where_the_law_does_and_has_the_visited_radius():
    operating_point = rocking()
    assert operating_point.rest.tolist() == pytest.approx([0.0], abs=1e-9)
    assert operating_point.visited_radius == pytest.approx(1.0, rel=0.01)
    assert operating_point.render_images(operating_point.rest[None], scale=2).shape == (1, 48, 64, 3)


def test_a_force_of_the_found_size_gives_the_requested_response():
    operating_point = rocking()
    grip, down = operating_point.grasp((20.0, 12.0), radius=1.0), np.array([0.0, 1.0])
    size = operating_point.find_force_size(grip, down, share=0.5)
    q = operating_point.equilibria(PointLoad(grip.points, size * torch.from_numpy(down)[None]))
    assert float((q - operating_point.rest).norm()) == pytest.approx(
        0.5 * operating_point.visited_radius, rel=1e-3
    )


def test_a_force_on_the_background_is_refused():
    operating_point = rocking()
    grip = operating_point.grasp((2.0, 2.0), radius=1.0)
    with pytest.raises(ValueError, match="moves nothing"):
        operating_point.find_force_size(grip, np.array([1.0, 0.0]), share=0.5)
