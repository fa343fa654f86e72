"""Records and their windows: nothing goes across a cut, and every frame of a clip is used."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lagsplat.diagnose.estimation.dataset import (
    FILE_BREAK_S,
    Dataset,
    WindowSet,
    cut_windows,
    join_trajectories,
)
from lagsplat.io.trajectory.trajectory import Trajectory


def record(lengths: list[int], *, dt: float = 0.02) -> Dataset:
    n, ends = sum(lengths), np.cumsum(lengths)
    clips = np.stack([ends - lengths, ends], axis=1)
    time = dt * np.arange(n)
    q = np.arange(n, dtype=float)[:, None]
    return Dataset(
        time, q, np.ones((n, 1)), np.zeros((n, 0)), clips, ("a",), np.zeros(len(lengths), np.int64), (0.0,)
    )


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(2, 90), min_size=1, max_size=6),
    st.floats(0.05, 3.0),
    st.integers(5, 25),
)
def test_windows_never_cross_a_cut_and_leave_no_frame_of_a_long_clip_out(
    lengths: list[int], length_s: float, least: int
) -> None:
    whole = record(lengths)
    if max(lengths) < least:
        with pytest.raises(ValueError, match=f"no clip has {least} frames"):
            cut_windows(whole, length_s=length_s, min_frames=least)
        return
    windows = cut_windows(whole, length_s=length_s, min_frames=least)
    covered = np.zeros(len(whole.time), int)
    for first, length in zip(windows.first, windows.length, strict=True):
        home = [(a, b) for a, b in whole.clips if a <= first < b]
        assert len(home) == 1
        assert first + length <= home[0][1]
        assert length >= least
        covered[first : first + length] += 1
    for start, stop in whole.clips:
        if stop - start < least:
            assert not covered[start:stop].any()
        else:
            assert (covered[start:stop] >= 1).all()
            assert covered[start] == covered[stop - 1] == 1
    assert covered.max() <= 2
    assert (covered == 2).sum() == len(windows.first) - sum(length >= least for length in lengths)


def test_samples_of_a_short_window_repeat_its_last_and_count_for_nothing() -> None:
    windows = WindowSet(np.array([0, 6]), np.array([5, 3]))
    taken = windows.take(record([10]).q)[..., 0]
    assert taken.tolist() == [[0, 1, 2, 3, 4], [6, 7, 8, 8, 8]]
    assert windows.mask().tolist() == [[1, 1, 1, 1, 1], [1, 1, 1, 0, 0]]
    assert windows.select(np.array([False, True])).first.tolist() == [6]


def motion(start: float, n: int, segments: tuple[tuple[int, int], ...], name: str) -> Trajectory:
    time, q, u = start + 0.1 * np.arange(n), np.full((n, 2), start), np.zeros((n, 1))
    return Trajectory(time_s=time, q=q, u=u, segments=segments, source=name)


def test_files_are_joined_after_a_break_and_their_clips_stay_apart() -> None:
    both = [motion(7.0, 12, ((0, 5), (5, 12)), "a.csv"), motion(100.0, 8, (), "b.csv")]
    whole = join_trajectories(both, [m.q for m in both])
    assert whole.clips.tolist() == [[0, 5], [5, 12], [12, 20]]
    assert whole.file_of.tolist() == [0, 0, 1]
    assert whole.files == ("a.csv", "b.csv")
    assert whole.time[[0, 12]] == pytest.approx([0.0, 1.1 + FILE_BREAK_S])
    assert whole.to_file_time(float(whole.time[14])) == (1, pytest.approx(100.2))
    assert whole.to_file_time(0.3) == (0, pytest.approx(7.3))
    assert whole.dt_s == pytest.approx(0.1)
    assert whole.d == 2


def test_clocks_that_go_on_from_file_to_file_are_kept() -> None:
    both = [motion(7.0, 12, (), "a.csv"), motion(9.0, 8, (), "b.csv")]
    whole = join_trajectories(both, [m.q for m in both])
    assert whole.time[[0, 12]] == pytest.approx([0.0, 2.0])
    assert whole.shifts_s == (7.0, 7.0)
    assert join_trajectories(both[::-1], [m.q for m in both]).time[8] > 0.0


@settings(max_examples=40, deadline=None)
@given(st.integers(4, 200), st.integers(5, 40), st.floats(1.0, 5000.0))
def test_windows_chosen_evenly_span_the_record_and_hold_as_many_frames_as_asked(
    n: int, length: int, frames: float
) -> None:
    windows = WindowSet(np.arange(n) * length, np.full(n, length))
    kept = windows.subsample(frames)
    if frames >= n * length:
        assert kept is windows
        return
    assert len(kept.first) == max(4, round(frames / length))
    assert (kept.first[0], kept.first[-1]) == (windows.first[0], windows.first[-1])
    gaps = np.diff(kept.first)
    assert gaps.max() - gaps.min() <= length
