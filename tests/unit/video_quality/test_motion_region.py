"""Where a film moves: noise does not count, a ball does, and the box holds its way."""

import numpy as np
import pytest

from lagsplat.video_quality.motion_region import find_motion_box, measure_motion


def film(way: float, *, noise: float, seed: int = 0) -> np.ndarray:
    """A bright disc of radius 4 at (40 + way, 30) in 60 x 100 pixels, with white noise [level]."""
    t = np.arange(200) / 20.0
    y, x = np.mgrid[:60, :100]
    at = 40.0 + way * np.sin(2.0 * np.pi * t)
    disc = 150.0 * np.clip(4.5 - np.hypot(x - at[:, None, None], y - 30.0), 0.0, 1.0)
    return (60.0 + disc + np.random.default_rng(seed).normal(0.0, noise, disc.shape)).astype(np.float32)


@pytest.mark.parametrize("noise", [0.0, 3.0, 12.0])
def test_noise_is_no_motion(noise: float) -> None:
    found = [find_motion_box(measure_motion(film(0.0, noise=noise, seed=seed))) for seed in range(10)]
    assert found == [None] * 10


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_the_box_holds_the_way_of_a_ball(noise: float) -> None:
    x, y, width, height = find_motion_box(measure_motion(film(15.0, noise=noise)))
    assert x <= 40 - 15 - 3
    assert x + width >= 40 + 15 + 4
    assert width < 60
    assert y <= 27
    assert y + height >= 34
    assert height < 24


def test_one_image_shows_no_motion() -> None:
    assert find_motion_box(measure_motion(film(15.0, noise=0.0)[:1])) is None
