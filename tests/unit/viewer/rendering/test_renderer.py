"""Drawing states at any size."""

from dataclasses import replace

import numpy as np
import torch

from lagsplat.report.figures.forces import turn_camera
from lagsplat.splat.projection import make_view
from lagsplat.viewer.rendering.renderer import open_renderer
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import turning


def test_a_state_is_drawn_as_the_decoder_draws_it():
    operating_point = rocking()
    picture = open_renderer(operating_point, side=64).draw(np.array([0.4]))
    expected = 255.0 * operating_point.render_images(torch.tensor([[0.4]], dtype=torch.float64), scale=2)[0]
    assert picture.shape == (48, 64, 3)
    np.testing.assert_allclose(picture, expected, atol=1.0)


def test_space_is_drawn_as_the_decoder_draws_it_from_two_cameras():
    operating_point, q = turning(), torch.tensor([[0.4]], dtype=torch.float64)
    renderer = open_renderer(operating_point, side=64)
    aside = turn_camera(operating_point, 25.0, 10.0)
    for picture, view in (
        (renderer.draw(q[0].numpy()), None),
        (renderer.render_view(q[0].numpy(), aside.resized(48, 64)), make_view([aside])),
    ):
        assert picture.shape == (48, 64, 3)
        np.testing.assert_allclose(
            picture, 255.0 * operating_point.render_images(q, scale=2, view=view)[0], atol=1.0
        )


def test_positions_are_projected_to_pixels_of_the_drawn_image():
    flat, deep = (open_renderer(operating_point, side=64) for operating_point in (rocking(), turning()))
    np.testing.assert_allclose(flat.project_points(np.array([[16.0, 12.0]])), [[32.0, 24.0]])
    np.testing.assert_allclose(flat.center, (16.0, 12.0))
    np.testing.assert_allclose(deep.project_points(np.array([[[8.0, 6.0, 200.0]]])), [[[40.0, 30.0]]])
    np.testing.assert_allclose(deep.project_points(np.array([deep.center])), [[32.0, 24.0]])


def test_a_camera_that_overflows_sees_only_the_background():
    operating_point = turning()
    renderer = open_renderer(operating_point, side=16)
    away = replace(renderer.recording_camera, position=np.full(3, 1e300))
    assert not renderer.render_view(operating_point.rest.numpy(), away).any()
