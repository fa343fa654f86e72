"""Pictures of states at a size of one's own choice."""

from dataclasses import replace

import numpy as np
import torch

from lagsplat.report.figures.forces import turn_camera
from lagsplat.splat.projection import make_view
from lagsplat.viewer.rendering.renderer import open_renderer
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import turning


def test_a_state_is_drawn_as_the_decoder_draws_it():
    held = rocking()
    picture = open_renderer(held.autoencoder, held.chart, side=64).draw(np.array([0.4]))
    expected = 255.0 * held.pictures(torch.tensor([[0.4]], dtype=torch.float64), scale=2)[0]
    assert picture.shape == (48, 64, 3)
    np.testing.assert_allclose(picture, expected, atol=1.0)


def test_space_is_drawn_as_the_decoder_draws_it_from_the_film_and_from_aside():
    held, q = turning(), torch.tensor([[0.4]], dtype=torch.float64)
    easel = open_renderer(held.autoencoder, held.chart, side=64)
    aside = turn_camera(held, 25.0, 10.0)
    for picture, view in (
        (easel.draw(q[0].numpy()), None),
        (easel.seen(q[0].numpy(), aside.resized(48, 64)), make_view([aside])),
    ):
        assert picture.shape == (48, 64, 3)
        np.testing.assert_allclose(picture, 255.0 * held.pictures(q, scale=2, view=view)[0], atol=1.0)


def test_places_are_found_in_the_drawn_picture():
    flat, deep = (open_renderer(held.autoencoder, held.chart, side=64) for held in (rocking(), turning()))
    np.testing.assert_allclose(flat.pixels(np.array([[16.0, 12.0]])), [[32.0, 24.0]])
    np.testing.assert_allclose(flat.middle, (16.0, 12.0))
    np.testing.assert_allclose(deep.pixels(np.array([[[8.0, 6.0, 200.0]]])), [[[40.0, 30.0]]])
    np.testing.assert_allclose(deep.pixels(np.array([deep.middle])), [[32.0, 24.0]])


def test_a_camera_beyond_the_numbers_sees_the_background_alone():
    held = turning()
    easel = open_renderer(held.autoencoder, held.chart, side=16)
    away = replace(easel.filmed, position=np.full(3, 1e300))
    assert not easel.seen(held.rest.numpy(), away).any()
