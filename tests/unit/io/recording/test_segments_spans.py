"""Spans of a recording become its clips."""

import numpy as np
import pytest

from lagsplat.io.recording.recording import Recording
from lagsplat.io.recording.segments import cut_spans


@pytest.fixture
def recording() -> Recording:
    n = 40
    return Recording(
        frames=np.arange(n, dtype=np.uint8)[:, None, None, None] * np.ones((1, 2, 2, 3), np.uint8),
        time_s=5.0 + 0.1 * np.arange(n),
        inputs=np.arange(n, dtype=float)[:, None],
        input_names=("u",),
        input_units=("N",),
        segments=((0, 25), (25, 40)),
        meta={"origin": "filmed", "source": "film.mp4"},
    )


def test_each_span_is_a_clip_and_none_is_glued_across_a_border(recording: Recording) -> None:
    cut = cut_spans(recording, [[0.15, 0.55], [2.25, 2.85]])
    numbers = [2, 3, 4, 5, 23, 24, 25, 26, 27, 28]
    np.testing.assert_array_equal(cut.frames[:, 0, 0, 0], numbers)
    np.testing.assert_array_equal(cut.inputs[:, 0], numbers)
    np.testing.assert_array_equal(cut.time_s, recording.time_s[numbers])
    assert cut.segments == ((0, 4), (4, 6), (6, 10))
    assert cut.meta["spans_s"] == [[0.15, 0.55], [2.25, 2.85]]


@pytest.mark.parametrize(
    ("spans", "message"),
    [
        ([[1.0, 2.0], [1.5, 2.5]], r"\[1\.5, 2\.5\] begins before 2\.0"),
        ([[2.0, 1.0]], "ends before it begins"),
        ([[0.0, 0.15]], "holds 2 frames of a recording of 3.9"),
        ([[10.0, 11.0]], "holds 0 frames"),
    ],
)
def test_spans_that_cannot_be_cut_are_refused(
    recording: Recording, spans: list[list[float]], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        cut_spans(recording, spans)
