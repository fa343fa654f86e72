"""Pictures of states at a size of one's own choice."""

import numpy as np
import torch

from lagsplat.viewer.easel import easel_of
from tests.unit.forces.rocking import rocking


def test_a_state_is_drawn_as_the_decoder_draws_it():
    held = rocking()
    picture = easel_of(held.autoencoder, held.chart, side=64).draw(np.array([0.4]))
    expected = 255.0 * held.pictures(torch.tensor([[0.4]], dtype=torch.float64), scale=2)[0]
    assert picture.shape == (48, 64, 3)
    np.testing.assert_allclose(picture, expected, atol=1.0)
