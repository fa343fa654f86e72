"""Numbers at the frames: exact for what is linear, nothing invented, nothing bridged."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagsplat.io.recording.alignment import InputLog, align_log

FRAMES = np.arange(0.0, 2.0, 0.1)


def line(times: np.ndarray, name: str = "a") -> InputLog:
    return InputLog(name, times, 3.0 * times - 1.0)


@given(st.integers(0, 1000))
def test_a_line_stays_a_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inner = np.unique(rng.uniform(0.0, 1.9, 200))
    aligned = align_log(FRAMES, [line(np.concatenate([[-0.1], inner, [2.0]]))], max_gap_s=1.0, source="s")
    assert aligned.kept.all()
    assert aligned.segments == ((0, len(FRAMES)),)
    np.testing.assert_allclose(aligned.inputs[:, 0], 3.0 * FRAMES - 1.0, atol=1e-12)


def test_without_logs_only_the_cameras_gaps_cut() -> None:
    frames = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    assert align_log(frames, [], max_gap_s=0.5, source="s").segments == ((0, 3), (3, 5))
    assert align_log(frames, [], max_gap_s=0.7, source="s").segments == ((0, 5),)


def test_a_gap_between_two_frames_cuts_without_dropping() -> None:
    frames = np.array([0.0, 0.3, 0.6, 0.9])
    log = line(np.array([-0.1, 0.0, 0.15, 0.3, 0.595, 0.75, 0.95]))
    assert align_log(frames, [log], max_gap_s=0.31, source="s").segments == ((0, 4),)
    wide = line(np.array([0.0, 0.3, 0.601, 0.9]))
    with pytest.warns(UserWarning, match=r"1 lie inside gaps of the inputs of more than 0\.3005 s"):
        aligned = align_log(frames, [wide], max_gap_s=0.3005, source="s")
    np.testing.assert_array_equal(aligned.kept, [True, True, False, True])
    assert aligned.segments == ((0, 2), (2, 3))
    slow = np.array([0.0, 1.0])
    edge = line(np.array([-0.5, 0.0, 1.0, 1.5]))
    assert align_log(slow, [edge], max_gap_s=1.0, source="s").segments == ((0, 2),)
    assert align_log(slow, [edge], max_gap_s=0.9, source="s").segments == ((0, 1), (1, 2))


def test_every_frame_has_every_number() -> None:
    early, late = line(np.arange(-0.05, 1.5, 0.1)), line(np.arange(0.55, 3.0, 0.1), "b")
    with pytest.warns(UserWarning, match="11 of 20 frames are dropped: 11 lie outside"):
        aligned = align_log(FRAMES, [early, late], max_gap_s=0.5, source="s")
    np.testing.assert_allclose(aligned.inputs, 3.0 * FRAMES[aligned.kept, None].repeat(2, 1) - 1.0)


@pytest.mark.parametrize(
    ("logs", "message"),
    [
        ([line(np.array([0.5]))], "has 1 samples"),
        (
            [line(np.array([5.0, 6.0]))],
            r"do not overlap; the camera runs from 0\.000 s to 1\.900 s, 'a'",
        ),
        ([line(np.array([-5.0, 6.0]))], "none of the 20 frames has a value of every input"),
    ],
)
def test_nothing_to_align(logs: list[InputLog], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        align_log(FRAMES, logs, max_gap_s=0.5, source="s")
