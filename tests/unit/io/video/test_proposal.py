"""Settings that follow from a film's size and from what was measured on it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.io.video.proposal import (
    choose_frame_size,
    fit_frame,
    measure_kept_motion,
    propose_crop,
    propose_settings,
)
from lagsplat.pipelines.steps import read_recording, reading_overrides
from tests.films import PERIOD_S, RATE, swing, write_film


@pytest.mark.parametrize(
    ("size", "frame"),
    [((1080, 1920), (54, 96)), ((360, 224), (96, 60)), ((24, 32), (24, 32)), ((4, 2000), (1, 96))],
)
def test_frames_keep_their_proportions(size: tuple[int, int], frame: tuple[int, int]) -> None:
    assert fit_frame(*size) == frame


def test_a_film_is_cut_stabilised_and_smoothed_by_what_it_shows(tmp_path: Path) -> None:
    frames, _ = swing(hand_until_s=1.0)
    path = write_film(tmp_path / "hand.mkv", frames, codec="FFV1")
    settings = compose("recording=filmed", f"recording.path={str(path)!r}").recording
    with pytest.warns(UserWarning, match="a hand perhaps"):
        proposed = propose_settings(read_recording(path), settings)
    assert proposed.skip_s == pytest.approx(1.0, abs=0.1)
    assert (proposed.height, proposed.width, proposed.stabilise) == (72, 96, False)
    assert proposed.smoothing_frames == pytest.approx(PERIOD_S * RATE / 20, rel=0.05)


def test_the_size_of_frames_follows_from_the_film_unless_it_is_set(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mkv", np.zeros((4, 120, 240, 3), np.uint8), codec="FFV1")
    plain = compose(*reading_overrides(path)).recording
    assert plain.height is None
    found = choose_frame_size(path, plain)
    assert (found.height, found.width) == (48, 96)
    cropped = choose_frame_size(path, replace(plain, crop=[0, 0, 60, 120]))
    assert (cropped.height, cropped.width) == (96, 48)
    own = replace(plain, height=30, width=20)
    assert choose_frame_size(path, own) is own


def test_a_crop_is_proposed_around_what_moves(tmp_path: Path) -> None:
    frames = np.full((60, 96, 128, 3), 90, np.uint8)
    for i, frame in enumerate(frames):
        x = 30 + round(12 * np.sin(i / 3.0))
        frame[40:56, x : x + 12] = 230
    path = write_film(tmp_path / "a.mkv", frames, codec="FFV1")
    settings = compose(*reading_overrides(path)).recording
    recording = read_recording(path)
    motion = measure_kept_motion(recording, settings)
    crop = propose_crop(recording, settings, motion)
    assert crop is not None
    x, y, width, height = crop
    assert x <= 18
    assert x + width >= 54
    assert y <= 40
    assert y + height >= 56
    assert width * height < 0.5 * 96 * 128
    assert propose_crop(recording, replace(settings, crop=[0, 0, 64, 64]), motion) is None
    assert propose_crop(recording, settings, np.zeros_like(motion)) is None
