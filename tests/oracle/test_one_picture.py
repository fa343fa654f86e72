"""One picture after another against the decoder, whose formulas it repeats."""

import numpy as np
import pytest
import torch

from lagsplat.splat.one_picture import OnePicture
from tests.unit.evaluate import tiny_run


@pytest.mark.parametrize("side", [16, 40])
def test_pictures_are_those_of_the_decoder(side: int) -> None:
    model = tiny_run.autoencoder()
    z = torch.randn(5, model.d)
    with torch.no_grad():
        expected = model.decode(z, height=side, width=side).numpy()
    drawer = OnePicture(model.gaussians, height=side, width=side, stretch=(side / 16, side / 16))
    for latent, image in zip(z.double().numpy(), expected, strict=True):
        got = drawer.draw(latent)
        assert got.shape == (side, side, 3)
        np.testing.assert_allclose(got, 255.0 * image.transpose(1, 2, 0), atol=1.0)


def test_a_state_that_is_not_finite_shows_the_background_alone() -> None:
    model = tiny_run.autoencoder()
    drawn = OnePicture(model.gaussians, height=16, width=16, stretch=(1.0, 1.0)).draw(np.full(2, np.nan))
    ground = model.gaussians.background().detach().numpy()
    np.testing.assert_allclose(drawn, np.broadcast_to(255.0 * ground, (16, 16, 3)), atol=1.0)
