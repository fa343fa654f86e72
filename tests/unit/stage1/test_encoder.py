"""The encoder's size, and where its latents start."""

import pytest
import torch

from lagsplat.stage1.encoder import Encoder, sensitivity, spread_latents


@pytest.mark.parametrize(("d", "expected"), [(1, 2055), (2, 2088), (4, 2154)])
def test_number_of_parameters_is_the_published_one(d, expected):
    encoder = Encoder(d, kernel=12, channels=2)
    assert sum(parameter.numel() for parameter in encoder.parameters()) == expected


@pytest.mark.parametrize("shape", [(16, 16), (32, 32), (64, 92), (33, 47)])
def test_any_image_size_is_encoded(shape):
    assert Encoder(3, kernel=12, channels=2)(torch.rand(2, 3, *shape)).shape == (2, 3)


def test_spread_latents_have_unit_covariance():
    images = torch.rand(200, 3, 16, 16)
    encoder = Encoder(4, kernel=12, channels=2)
    assert torch.linalg.eigvalsh(encoder(images).T.cov())[-1] < 0.1
    spread_latents(encoder, images)
    latents = encoder(images).detach().double()
    torch.testing.assert_close(latents.T.cov(), torch.eye(4, dtype=torch.float64), atol=2e-2, rtol=0)
    torch.testing.assert_close(latents.mean(0), torch.zeros(4, dtype=torch.float64), atol=2e-2, rtol=0)


def test_a_single_frame_leaves_the_latent_closed_but_finite():
    encoder = Encoder(2, kernel=12, channels=2)
    spread_latents(encoder, torch.rand(1, 3, 16, 16))
    assert torch.isfinite(encoder.head.weight).all()


def test_sensitivity_bounds_a_step_of_adam():
    torch.manual_seed(1)
    images = torch.rand(4, 3, 16, 16)
    encoder = Encoder(2, kernel=12, channels=2)
    spread_latents(encoder, images)
    before, bound, rate = encoder(images).detach(), sensitivity(encoder, images), 1e-6
    optimizer = torch.optim.Adam(encoder.parameters(), lr=rate)
    encoder(images)[:, 0].sum().backward()
    optimizer.step()
    moved = (encoder(images) - before).abs()[:, 0].mean().item()
    assert 0.2 * rate * bound < moved < 2 * rate * bound
