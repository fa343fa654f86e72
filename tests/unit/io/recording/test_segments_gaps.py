"""Films that were torn, and films that only lost a frame."""

import numpy as np
import pytest

from lagsplat.io.recording.recording import Recording
from lagsplat.io.recording.segments import cut_at_gaps


def recording(steps: list[float], *segments: tuple[int, int]) -> Recording:
    """Frames and inputs that carry their own number, ``steps`` apart."""
    n = len(steps) + 1
    return Recording(
        frames=np.broadcast_to(np.arange(n, dtype=np.uint8)[:, None, None, None], (n, 1, 1, 3)),
        time_s=np.concatenate([[0.0], np.cumsum(steps)]),
        inputs=np.arange(n)[:, None],
        input_names=("u",),
        input_units=("N",),
        segments=segments,
        meta={"origin": "filmed", "source": "torn.mp4"},
    )


def test_a_few_dropped_frames_are_bridged() -> None:
    film = recording([0.02] * 10 + [0.04] + [0.02] * 10 + [0.099] + [0.02] * 3)
    assert cut_at_gaps(film) is film


def test_longer_gaps_cut_and_say_where() -> None:
    film = recording([0.02] * 10 + [0.2] + [0.02] * 10 + [3.0] + [0.02] * 9)
    with pytest.warns(
        UserWarning, match=r"torn.mp4: 2 gap\(s\).* 0\.200 s after frame 10, 3\.000 s after frame 21"
    ):
        cut = cut_at_gaps(film)
    assert cut.segments == ((0, 11), (11, 22), (22, 32))
    np.testing.assert_array_equal(cut.time_s, film.time_s)


def test_short_pieces_are_left_out_and_nothing_else_is() -> None:
    film = recording([0.02] * 10 + [1.0] + [0.02] * 6 + [1.0] + [0.02] * 9 + [0.02] * 3, (0, 27), (27, 31))
    with pytest.warns(UserWarning, match=r"1 piece\(s\) of fewer than 8 frames, 7 in all, are left out"):
        cut = cut_at_gaps(film)
    assert cut.segments == ((0, 11), (11, 20), (20, 24))
    np.testing.assert_array_equal(cut.inputs[:, 0], [*range(11), *range(18, 31)])
    np.testing.assert_array_equal(cut.frames[:, 0, 0, 0], cut.inputs[:, 0])


def test_borders_of_clips_are_no_gaps_and_a_film_in_shreds_is_refused() -> None:
    film = recording([0.02] * 4 + [5.0] + [0.02] * 4, (0, 5), (5, 10))
    assert cut_at_gaps(film) is film
    with pytest.raises(ValueError, match="No piece between them has 8 frames"):
        cut_at_gaps(recording(([0.02] * 4 + [5.0]) * 3))
