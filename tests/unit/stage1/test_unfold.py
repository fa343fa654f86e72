"""The encoder's start: smooth filters, and latents that follow a motion wider than what moves."""

import numpy as np
import pytest
import torch
from scipy.stats import spearmanr

from lagsplat.stage1.encoder import Encoder
from lagsplat.stage1.encoder_initialization import (
    compute_geodesic_coordinates,
    draw_smooth_filters,
    fit_readout,
    initialize_encoder,
    remove_squares,
)
from lagsplat.stage1.training_data import TrainingFrames


def travelling_blob(positions, *, height=24, width=40):
    """A bright spot of 2 px on a grey ground, its column given, its row fixed."""
    rows, columns = np.mgrid[:height, :width] + 0.5
    spots = [np.exp(-((columns - x) ** 2 + (rows - 12) ** 2) / 8) for x in positions]
    return torch.as_tensor(np.repeat(0.3 + 0.6 * np.stack(spots)[:, None], 3, axis=1), dtype=torch.float32)


def film(images):
    """The images as stored frames."""
    return TrainingFrames((255 * images.numpy()).round().astype(np.uint8).transpose(0, 2, 3, 1))


@pytest.fixture
def motion():
    positions = np.random.default_rng(0).uniform(5, 35, 200)
    return positions, travelling_blob(positions)


@pytest.mark.parametrize("seed", range(4))
def test_a_motion_wider_than_the_object_is_not_folded(motion, seed):
    positions, images = motion
    torch.manual_seed(seed)
    encoder = Encoder(1, kernel=12, channels=2)
    initialize_encoder(encoder, film(images), seed=0)
    latents = encoder(images).detach().numpy()[:, 0]
    assert abs(spearmanr(positions, latents).statistic) > 0.98
    assert latents.std() == pytest.approx(1.0, abs=0.1)


def test_filters_that_miss_the_motion_are_drawn_again_apart_from_the_stream_of_random_numbers(motion):
    positions, images = motion
    torch.manual_seed(0)
    encoder = Encoder(1, kernel=12, channels=2)
    expected = torch.get_rng_state()
    with torch.no_grad():
        encoder.convolutions[0].weight.zero_()
    initialize_encoder(encoder, film(images), seed=0)
    latents = encoder(images).detach().numpy()[:, 0]
    assert abs(spearmanr(positions, latents).statistic) > 0.98
    assert torch.equal(torch.get_rng_state(), expected)


def test_geodesic_coordinates_are_positions_along_the_motion(motion):
    positions, images = motion
    coordinates = compute_geodesic_coordinates(images, 1)[:, 0]
    assert abs(np.corrcoef(positions, coordinates)[0, 1]) > 0.99
    assert coordinates.mean() == pytest.approx(0, abs=1e-9)
    assert coordinates.std() == pytest.approx(1)


def test_the_second_coordinate_is_no_square_of_the_first():
    """A spot that moves far along an arc and little across it: only blurred distances see the little."""
    rng = np.random.default_rng(1)
    angle, radius = rng.uniform(-1, 1, 500), rng.uniform(-2, 2, 500)
    rows, columns = np.mgrid[:40, :40] + 0.5
    x, y = 20 + (16 + radius) * np.sin(angle), 2 + (16 + radius) * np.cos(angle) + 8
    spots = [np.exp(-((columns - a) ** 2 + (rows - b) ** 2) / 8) for a, b in zip(x, y, strict=True)]
    images = torch.as_tensor(np.repeat(0.3 + 0.6 * np.stack(spots)[:, None], 3, axis=1), dtype=torch.float32)
    first, second = compute_geodesic_coordinates(images, 2).T
    assert abs(np.corrcoef(first, angle)[0, 1]) > 0.98
    assert abs(np.corrcoef(second, radius)[0, 1]) > 0.9


def test_the_start_is_the_same_for_the_same_seed(motion):
    _, images = motion
    weights = []
    for _ in range(2):
        torch.manual_seed(3)
        encoder = Encoder(1, kernel=12, channels=2)
        initialize_encoder(encoder, film(images), seed=0)
        weights.append(encoder.head.weight.detach().clone())
    assert torch.equal(*weights)


def test_blurred_filters_are_smoother_and_as_large():
    torch.manual_seed(0)
    encoder = Encoder(2, kernel=12, channels=2)
    before = [bank.detach().clone() for bank in encoder.filters()]
    draw_smooth_filters(encoder)
    after = [bank.detach() for bank in encoder.filters()]
    for bank, rough in zip(after, before, strict=True):
        assert bank.norm() == pytest.approx(rough.norm().item(), rel=1e-5)
        assert bank.diff(dim=-1).norm() < 0.5 * rough.diff(dim=-1).norm()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_frames_than_axes_leave_axes_closed_but_finite(count):
    images = travelling_blob(np.linspace(10, 30, count))
    encoder = Encoder(4, kernel=12, channels=2)
    initialize_encoder(encoder, film(images), seed=0)
    assert torch.isfinite(encoder.head.weight).all()
    assert (encoder.head.weight.abs().amax(1) > 0).sum() <= count - 1


def test_repeated_frames_count_once():
    images = travelling_blob(np.full(30, 20.0))
    encoder = Encoder(2, kernel=12, channels=2)
    initialize_encoder(encoder, film(images), seed=0)
    assert not encoder.head.weight.any()


def test_large_frames_are_compared_small():
    positions = np.linspace(10, 190, 400)
    images = travelling_blob(positions, height=120, width=200)
    coordinates = compute_geodesic_coordinates(images, 1)[:, 0]
    assert abs(spearmanr(positions, coordinates).statistic) > 0.98


def test_straightening_removes_the_square_and_keeps_the_scale(motion):
    _, images = motion
    torch.manual_seed(0)
    encoder = Encoder(2, kernel=12, channels=8)
    s = compute_geodesic_coordinates(images, 1)
    bent = np.c_[s, 0.5 * s**2 + 0.1 * np.sin(9 * s)]
    draw_smooth_filters(encoder)
    fit_readout(encoder, images, bent)
    before = encoder(images).detach().numpy()
    remove_squares(encoder, images)
    after = encoder(images).detach().numpy()
    assert abs(np.corrcoef(before[:, 0] ** 2, before[:, 1])[0, 1]) > 0.8
    assert abs(np.corrcoef(after[:, 0] ** 2, after[:, 1])[0, 1]) < 0.1
    np.testing.assert_allclose(after[:, 0], before[:, 0], atol=0.05)
