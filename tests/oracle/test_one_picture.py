"""One picture after another against the decoder, whose formulas it repeats."""

import numpy as np
import pytest
import torch

from lagsplat.splat.cpu.slice import FrameRasterizer, slice_at
from lagsplat.splat.gaussians import Gaussians
from lagsplat.splat.image_model import rasterize
from tests.unit.evaluate import tiny_run


@pytest.mark.parametrize("side", [16, 40])
def test_pictures_are_those_of_the_decoder(side: int) -> None:
    model = tiny_run.autoencoder()
    z = torch.randn(5, model.d)
    with torch.no_grad():
        expected = model.decode(z, height=side, width=side).numpy()
    drawer = FrameRasterizer(model.gaussians, height=side, width=side, stretch=(side / 16, side / 16))
    for latent, image in zip(z.double().numpy(), expected, strict=True):
        got = drawer.draw(latent)
        assert got.shape == (side, side, 3)
        np.testing.assert_allclose(got, 255.0 * image.transpose(1, 2, 0), atol=1.0)


def test_gaussians_that_have_faded_or_left_the_picture_are_passed_over_and_no_others() -> None:
    torch.manual_seed(3)
    cloud = Gaussians(203, 4)  # no multiple of the lanes
    with torch.no_grad():
        cloud.center.uniform_(-12.0, 40.0)
        cloud.latent_center.normal_()
        cloud.coupling.normal_(0.0, 3.0)
        cloud.precision_below.normal_(0.0, 0.3)
        cloud.shape_log_diagonal.uniform_(0.2, 1.2)
        cloud.shape_below.normal_()
        cloud.opacity_logit.normal_(0.0, 2.0)
        cloud.color_logit.normal_()
    drawer = FrameRasterizer(cloud, height=24, width=30, stretch=(1.0, 1.0))
    for z in torch.randn(6, 4):
        scene = cloud.condition(z[None])
        expected = rasterize(*scene, height=24, width=30)[0].detach().numpy()
        np.testing.assert_allclose(
            drawer.draw(z.double().numpy()), 255.0 * expected.transpose(1, 2, 0), atol=0.51
        )
        spots, _, _ = slice_at(z.numpy(), drawer.table, drawer.slices, drawer.color, 24, 30)
        seen = int(np.isfinite(spots[0, 0]).sum())
        assert 0 < seen < int((scene.opacity >= 1 / 255).sum())


def test_a_state_that_is_not_finite_shows_the_background_alone() -> None:
    model = tiny_run.autoencoder()
    drawn = FrameRasterizer(model.gaussians, height=16, width=16, stretch=(1.0, 1.0)).draw(np.full(2, np.nan))
    ground = model.gaussians.background().detach().numpy()
    np.testing.assert_allclose(drawn, np.broadcast_to(255.0 * ground, (16, 16, 3)), atol=1.0)
