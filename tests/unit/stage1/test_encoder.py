"""The encoder's size, and how far a step may move its latents."""

import pytest
import torch

from lagsplat.stage1.autoencoder import to_images
from lagsplat.stage1.encoder import Encoder, limit_latent_step
from lagsplat.stage1.encoder_initialization import initialize_encoder
from lagsplat.stage1.training_data import TrainingFrames
from tests.unit.stage1.problems import swinging_bar


@pytest.mark.parametrize(("d", "expected"), [(1, 2055), (2, 2088), (4, 2154)])
def test_number_of_parameters_is_the_published_one(d, expected):
    encoder = Encoder(d, kernel=12, channels=2)
    assert sum(parameter.numel() for parameter in encoder.parameters()) == expected


@pytest.mark.parametrize("shape", [(16, 16), (32, 32), (64, 92), (33, 47)])
def test_any_image_size_is_encoded(shape):
    assert Encoder(3, kernel=12, channels=2)(torch.rand(2, 3, *shape)).shape == (2, 3)


def started_encoder():
    torch.manual_seed(1)
    frames = swinging_bar(16)
    images = to_images(frames)
    encoder = Encoder(1, kernel=12, channels=2)
    initialize_encoder(encoder, TrainingFrames(frames), seed=0)
    return encoder, images


@pytest.mark.parametrize("limit", [1e-3, 1e-2])
def test_a_step_that_would_move_the_latents_too_far_is_shortened(limit):
    encoder, images = started_encoder()
    before = encoder(images).detach()
    with limit_latent_step(encoder, images, limit=limit), torch.no_grad():
        for parameter in encoder.parameters():
            parameter.add_(1e-3)
    move = (encoder(images) - before).square().mean().sqrt().item()
    spread = (before - before.mean(0)).square().mean().sqrt().item()
    assert move == pytest.approx(limit * spread, rel=0.3)


@pytest.mark.parametrize("limit", [None, 1e3])
def test_a_step_within_the_limit_is_left_alone(limit):
    encoder, images = started_encoder()
    weight = encoder.head.weight.detach().clone()
    with limit_latent_step(encoder, images, limit=limit), torch.no_grad():
        encoder.head.weight.add_(1e-3)
    torch.testing.assert_close(encoder.head.weight.detach(), weight + 1e-3, rtol=0, atol=0)
