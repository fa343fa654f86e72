"""The encoder's size, and how far its latents move in a step."""

import pytest
import torch

from lagsplat.stage1.encoder import Encoder, sensitivity
from lagsplat.stage1.unfold import unfold


@pytest.mark.parametrize(("d", "expected"), [(1, 2055), (2, 2088), (4, 2154)])
def test_number_of_parameters_is_the_published_one(d, expected):
    encoder = Encoder(d, kernel=12, channels=2)
    assert sum(parameter.numel() for parameter in encoder.parameters()) == expected


@pytest.mark.parametrize("shape", [(16, 16), (32, 32), (64, 92), (33, 47)])
def test_any_image_size_is_encoded(shape):
    assert Encoder(3, kernel=12, channels=2)(torch.rand(2, 3, *shape)).shape == (2, 3)


def test_sensitivity_bounds_a_step_of_adam():
    torch.manual_seed(1)
    images = torch.rand(4, 3, 16, 16)
    encoder = Encoder(2, kernel=12, channels=2)
    unfold(encoder, images)
    before, bound, rate = encoder(images).detach(), sensitivity(encoder, images), 1e-6
    optimizer = torch.optim.Adam(encoder.parameters(), lr=rate)
    encoder(images)[:, 0].sum().backward()
    optimizer.step()
    moved = (encoder(images) - before).abs()[:, 0].mean().item()
    assert 0.2 * rate * bound < moved < 2 * rate * bound
