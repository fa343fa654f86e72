"""Faults of known size are measured as planted, and a clean film raises none."""

from typing import Any

import numpy as np
import pytest

from lagsplat.video_quality.assessment import VideoAssessment, assess_video
from lagsplat.video_quality.frames import Thumbnails
from tests.films import PERIOD_S, RATE, swing


def check(frames: np.ndarray, time_s: np.ndarray) -> VideoAssessment:
    thumbnails = Thumbnails()
    for frame in frames:
        thumbnails.add(np.ascontiguousarray(frame[..., ::-1]))
    return assess_video(frames, time_s, thumbnails)


def checked(**planted: Any) -> VideoAssessment:
    return check(*swing(**planted))


def test_clean_film_is_measured_and_not_warned_of() -> None:
    found = checked()
    assert found.warnings == ()
    assert found.camera is not None
    assert found.camera.rms_px < 0.05
    assert found.flicker is not None
    assert found.flicker.rms_percent < 0.2
    assert found.sampling is not None
    assert found.sampling.period_s == pytest.approx(PERIOD_S, rel=0.02)
    assert found.sampling.samples == pytest.approx(PERIOD_S * RATE, rel=0.02)
    assert found.cuts == ()
    assert found.repeat is None
    assert found.visit is None
    assert found.skip_s is None
    assert found.end_s is None


def test_camera_shake_and_drift_are_measured() -> None:
    def camera(t: float) -> tuple[float, float]:
        return 0.5 * t + 0.8 * np.sin(2 * np.pi * 3.1 * t), 0.6 * np.sin(2 * np.pi * 4.3 * t + 1.0)

    found = checked(camera=camera)
    path = np.array([camera(t) for t in np.arange(150) / RATE])
    path -= path[0]
    assert found.camera is not None
    rms = np.sqrt(((path - path.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert found.camera.rms_px == pytest.approx(rms, abs=0.05)
    assert found.camera.max_px == pytest.approx(np.hypot(*path.T).max(), abs=0.1)
    assert found.camera.drift_px == pytest.approx(3.0, abs=0.6)
    assert found.camera.jitter_px == pytest.approx(np.sqrt(0.8**2 / 2 + 0.6**2 / 2), abs=0.12)
    assert [text for text in found.warnings if "camera moves" in text]
    assert "recording.stabilise=true" in found.warnings[0]


def test_flicker_is_measured() -> None:
    found = checked(gain=lambda t: 1.0 + 0.05 * np.sin(2 * np.pi * 3.0 * t))
    assert found.flicker is not None
    assert found.flicker.rms_percent == pytest.approx(5.0 / np.sqrt(2.0), rel=0.05)
    assert found.flicker.frequency_hz == pytest.approx(3.0, abs=0.05)
    assert len(found.warnings) == 1
    assert "flickers by 3.5 % rms, mostly at 3.0" in found.warnings[0]


def test_a_jump_is_found_where_it_is() -> None:
    found = checked(phase=lambda t: 2.5 if t >= 4.0 else 0.0, period_s=4.0)
    assert [cut.time_s for cut in found.cuts] == pytest.approx([4.0])
    assert found.end_s == 4.0
    assert len(found.warnings) == 1
    assert "recording.end_s=4" in found.warnings[0]


def test_a_change_of_scene_is_a_cut() -> None:
    frames, time_s = swing()
    frames[:30] = np.roll(frames[:30], 60, axis=2)[:, ::-1]
    found = check(frames, time_s)
    assert [cut.time_s for cut in found.cuts] == pytest.approx([30 / RATE])
    assert found.skip_s == 30 / RATE
    assert found.visit is None


def test_one_bright_frame_is_no_cut() -> None:
    frames, time_s = swing()
    frames[70] = np.minimum(255, frames[70].astype(int) + 60)
    assert check(frames, time_s).cuts == ()


def test_a_loop_is_found() -> None:
    frames, time_s = swing()
    frames[100:] = frames[25:75]
    found = check(frames, time_s)
    assert found.repeat is not None
    assert found.repeat.start_s == pytest.approx(4.0, abs=0.05)
    assert found.repeat.original_s == pytest.approx(1.0, abs=0.05)
    assert found.repeat.stop_s == pytest.approx(time_s[-1], abs=0.05)
    assert [text for text in found.warnings if "repeats itself" in text]


def test_a_hand_at_the_start_is_found_until_it_leaves() -> None:
    found = checked(hand_until_s=1.5)
    assert found.visit is not None
    assert found.visit.gone_s == pytest.approx(1.5, abs=1.5 / RATE)
    assert found.visit.back_s is None
    assert found.skip_s is not None
    assert any(f"recording.skip_s={found.skip_s:g}" in text for text in found.warnings)


def test_a_hand_at_the_end_is_found() -> None:
    frames, time_s = swing(hand_until_s=1.0)
    found = check(frames[::-1].copy(), time_s)
    assert found.visit is not None
    assert found.visit.gone_s is None
    assert found.visit.back_s == pytest.approx(5.0, abs=1.5 / RATE)
    assert found.end_s == pytest.approx(5.0, abs=2.0 / RATE)


def test_a_swing_that_comes_to_rest_is_no_hand() -> None:
    moving, still = swing(seconds=4.0)[0], swing(seconds=10.0, amplitude=0.0)[0]
    frames = np.concatenate([moving, still])
    found = check(frames, np.arange(len(frames)) / RATE)
    assert found.visit is None
    assert found.skip_s is None


@pytest.mark.parametrize(("samples", "words"), [(2.7, "near the Nyquist limit"), (6.3, "8 or more")])
def test_too_few_samples_a_period(samples: float, words: str) -> None:
    found = checked(period_s=samples / RATE, seconds=8.0, amplitude=0.12)
    assert found.sampling is not None
    assert found.sampling.samples == pytest.approx(samples, rel=0.03)
    assert any(f"only {samples} frames a period" in text and words in text for text in found.warnings)


def test_noise_has_no_period_and_no_background() -> None:
    frames = np.random.default_rng(0).integers(90, 110, (80, 40, 50, 1), dtype=np.uint8).repeat(3, axis=-1)
    found = check(frames, np.arange(80) / RATE)
    assert found.sampling is None
    assert found.camera is None
    assert found.warnings == ()


def test_a_blank_or_short_film_is_no_error() -> None:
    blank = check(np.zeros((40, 30, 40, 3), np.uint8), np.arange(40) / RATE)
    assert blank.warnings == ()
    assert blank.camera is None
    short = check(*(part[:10] for part in swing()))
    assert short.sampling is None
    assert short.numbers["cuts"] == []


def test_thumbnails_are_few_even_and_small() -> None:
    thumbnails = Thumbnails()
    for i in range(1000):
        thumbnails.add(np.full((20, 480, 3), i // 4, np.uint8))
    assert 150 <= len(thumbnails.pictures) <= 301
    assert thumbnails.scale == 3.0
    assert thumbnails.pictures[0].shape == (7, 160)
    levels = np.array([int(picture[0, 0]) for picture in thumbnails.pictures])
    assert levels[0] == 0
    assert set(np.diff(levels)) == {1}
