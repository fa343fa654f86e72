"""Datasets: windows cross no cut and use every frame of a clip; inputs never come from another clip."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lagsplat.diagnose.data_quality.noise import LocalFit
from lagsplat.diagnose.data_quality.sampling import average_samples
from lagsplat.diagnose.effects.actuation import input_backlash, input_delay, input_lag
from lagsplat.diagnose.effects.measurement import time_offset
from lagsplat.diagnose.estimation.dataset import (
    FILE_BREAK_S,
    Dataset,
    WindowSet,
    compare_noise,
    cut_windows,
    join_trajectories,
)
from lagsplat.diagnose.estimation.input_signals import (
    build_input_signals,
    compute_stage_times,
    interpolate_input,
)
from lagsplat.io.trajectory.trajectory import Trajectory


def evenly_sampled_dataset(lengths: list[int], *, dt: float = 0.02) -> Dataset:
    n, ends = sum(lengths), np.cumsum(lengths)
    clips = np.stack([ends - lengths, ends], axis=1)
    time = dt * np.arange(n)
    q = np.arange(n, dtype=float)[:, None]
    return Dataset(
        time, q, np.ones((n, 1)), np.zeros((n, 0)), clips, ("a",), np.zeros(len(lengths), np.int64), (0.0,), q
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
    whole = evenly_sampled_dataset(lengths)
    if max(lengths) < least:
        with pytest.raises(ValueError, match=f"no clip has {least} samples"):
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
    taken = windows.take(evenly_sampled_dataset([10]).q)[..., 0]
    assert taken.tolist() == [[0, 1, 2, 3, 4], [6, 7, 8, 8, 8]]
    assert windows.mask().tolist() == [[1, 1, 1, 1, 1], [1, 1, 1, 0, 0]]
    assert windows.select(np.array([False, True])).first.tolist() == [6]


def motion(start: float, n: int, segments: tuple[tuple[int, int], ...], name: str) -> Trajectory:
    time, q, u = start + 0.1 * np.arange(n), np.full((n, 2), start), np.zeros((n, 1))
    return Trajectory(time_s=time, q=q, u=u, segments=segments, source=name)


def still(motions: list[Trajectory]) -> list[LocalFit]:
    """Fits of motions that rest: their rates and accelerations are zero."""
    return [LocalFit(m.q, 0.0 * m.q, 0.0 * m.q, np.zeros(m.n)) for m in motions]


def test_files_are_joined_after_a_break_and_their_clips_stay_apart() -> None:
    both = [motion(7.0, 12, ((0, 5), (5, 12)), "a.csv"), motion(100.0, 8, (), "b.csv")]
    whole = join_trajectories(both, still(both))
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
    whole = join_trajectories(both, still(both))
    assert whole.time[[0, 12]] == pytest.approx([0.0, 2.0])
    assert whole.shifts_s == (7.0, 7.0)
    assert join_trajectories(both[::-1], still(both[::-1])).time[8] > 0.0


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


TIME = np.array([0.0, 0.1, 0.25, 0.3, 0.0, 0.2, 0.3])
U = np.array([1.0, 3.0, -2.0, 0.5, 10.0, 12.0, 11.0])
CLIPS = np.array([[0, 4], [4, 7]])


def driven_dataset() -> Dataset:
    blank = np.zeros((7, 1))
    return Dataset(TIME, blank, blank, U[:, None], CLIPS, ("a", "b"), np.array([0, 1]), (0.0, 0.0), blank)


def test_stages_are_the_beginning_middle_and_end_of_every_substep() -> None:
    time, clip = compute_stage_times(driven_dataset(), 2)
    assert time[1] == pytest.approx(np.array([[0.1, 0.1375, 0.175], [0.175, 0.2125, 0.25]]))
    assert np.ptp(time[3]) == 0.0  # the last frame of a clip leads nowhere
    assert clip.tolist() == [0, 0, 0, 0, 1, 1, 1]


def test_between_samples_an_input_is_a_line_or_held() -> None:
    straight = build_input_signals(driven_dataset(), steps=2, held=False)[0].values.reshape(7, 2, 3)
    assert straight[0].ravel().tolist() == pytest.approx([1.0, 1.5, 2.0, 2.0, 2.5, 3.0])
    assert straight[4, 0, 0] == 10.0
    held = build_input_signals(driven_dataset(), steps=2, held=True)[0].values.reshape(7, 2, 3)
    for n in (0, 1, 2, 4, 5):
        assert (held[n] == U[n]).all()


def test_where_a_sample_is_missing_a_smooth_input_bends_on_and_a_step_goes_no_further() -> None:
    time = np.delete(0.1 * np.arange(60), 30)
    sine = np.cos(2.0 * (time - 3.0))
    at = np.array([2.95, 3.0, 3.05])
    assert interpolate_input(at, time, sine) == pytest.approx(np.cos(2.0 * (at - 3.0)), abs=4e-3)
    assert interpolate_input(np.array([2.05]), time, sine) == pytest.approx(sine[20:22].mean())
    assert interpolate_input(at, time[:1], sine[:1]).tolist() == [sine[0]] * 3
    assert np.interp(3.0, time, sine) == pytest.approx(np.cos(0.2)) != pytest.approx(1.0, abs=1e-2)
    step = (time > 3.0).astype(float)
    across = interpolate_input(np.linspace(2.0, 4.0, 99), time, step)
    assert across.min() >= 0.0
    assert across.max() <= 1.0


@pytest.mark.parametrize("held", [False, True])
def test_a_delayed_input_is_the_earlier_one_and_does_not_look_into_another_clip(held: bool) -> None:
    signal = build_input_signals(driven_dataset(), steps=2, held=held)[0]
    late = input_delay.EFFECT.change(signal, np.array([[0.0], [0.12]])).reshape(2, 7, 2, 3)
    assert np.array_equal(late[0].ravel(), signal.values)
    assert late[1, 1, 0, 0] == 1.0  # before the first sample, that sample
    assert late[1, 4, 0, 0] == 10.0
    assert late[1, 2, 0, 0] == pytest.approx(3.0 if held else 3.0 - 5.0 * 0.03 / 0.15)


def test_motion_that_is_stamped_late_looks_like_a_late_input() -> None:
    signal = build_input_signals(driven_dataset(), steps=2, held=False)[0]
    late = input_delay.EFFECT.change(signal, np.array([[0.12]]))
    assert np.array_equal(time_offset.EFFECT.change(signal, np.array([[-0.12]])), late)


def test_a_lag_answers_a_held_step_as_an_exponential() -> None:
    time = 0.05 * np.arange(20)
    u = np.where(time < 0.099, 0.0, 2.0)[:, None]
    blank = np.zeros((20, 1))
    whole = Dataset(time, blank, blank, u, np.array([[0, 20]]), ("a",), np.zeros(1, np.int64), (0.0,), blank)
    signal = build_input_signals(whole, steps=3, held=True)[0]
    out = input_lag.EFFECT.change_input(signal, np.array([[0.2]])).reshape(20, 3, 3)[:, 0, 0]
    assert out == pytest.approx(2.0 * -np.expm1(-np.maximum(time - 0.1, 0.0) / 0.2), abs=1e-5)


def test_a_lag_that_had_not_settled_begins_where_its_parameters_say() -> None:
    signal = build_input_signals(driven_dataset(), steps=1, held=False)[0]
    effect = input_lag.EFFECT.with_free_memory([1])
    assert [p.kind for p in effect.parameters] == ["time", "input"]
    moved = effect.change_input(signal, np.array([[0.2, -3.0]])).reshape(7, 3)[:, 0]
    settled = input_lag.EFFECT.change_input(signal, np.array([[0.2]])).reshape(7, 3)[:, 0]
    fade = np.array([0.0, 0.0, 0.0, 0.0, 1.0, np.exp(-1.0), np.exp(-1.5)])
    assert moved - settled == pytest.approx(-3.0 * fade)
    assert effect.with_free_memory(()) == input_lag.EFFECT


def test_play_follows_at_half_its_width_and_forgets_between_clips() -> None:
    signal = build_input_signals(driven_dataset(), steps=1, held=False)[0]
    out = input_backlash.EFFECT.change(signal, np.array([[2.0, 0.0]]))[0].reshape(7, 3)[:, 0]
    assert out.tolist() == pytest.approx([1.0, 2.0, -1.0, -0.5, 10.0, 11.0, 11.0])


@pytest.mark.parametrize("held", [False, True])
def test_what_play_gives_is_averaged_and_not_what_it_gets(held: bool) -> None:
    """The force after the play has the means of the play's own answer to every sample of the log."""
    time = 0.001 * np.arange(600)
    u = np.sin(30.0 * time) + 2.0 * (time > 0.2973)
    blank = np.zeros((600, 1))
    motion = average_samples(Trajectory(time_s=time, q=blank, u=u[:, None]), 6, held=held)
    fit = LocalFit(motion.q, motion.q, motion.q, motion.q[:, 0])
    record = join_trajectories([motion], [fit])
    signal = build_input_signals(record, steps=2, held=held)[0]
    stages = signal.to_stages(input_backlash.EFFECT.change(signal, np.array([[0.6, 0.0]])))
    given = np.empty(600)
    given[0] = u[0]
    for k in range(1, 600):
        given[k] = min(max(given[k - 1], u[k] - 0.3), u[k] + 0.3)
    begins, middles, ends = stages.reshape(100, 2, 3).transpose(2, 0, 1)
    lines = (begins + 4.0 * middles + ends)[:-1].sum(axis=1) / 12.0
    means = 0.5 * (given.reshape(100, 6).mean(axis=1)[1:] + given.reshape(100, 6).mean(axis=1)[:-1])
    assert lines.sum() == pytest.approx(means.sum(), rel=2e-3)
    assert stages.max() == pytest.approx(given.max(), abs=0.01)


def test_frames_that_are_means_of_fewer_samples_have_more_noise() -> None:
    one = Trajectory(time_s=0.01 * np.arange(40), q=np.zeros((40, 1)), u=np.zeros((40, 0)))
    log = Trajectory(time_s=0.001 * np.arange(360), q=np.zeros((360, 1)), u=np.zeros((360, 0)))
    many = average_samples(log, 9, held=False)
    relative = compare_noise([one, many])
    assert relative[0] / relative[1] == pytest.approx(3.0)
    assert np.mean(relative**2) == pytest.approx(1.0)
    assert compare_noise([many, many]) == pytest.approx(np.ones(2))


def test_halves_of_windows_share_a_frame_and_short_windows_stay_whole() -> None:
    halves = WindowSet(np.array([0, 39, 60]), np.array([40, 22, 41])).halve(20)
    assert halves.first.tolist() == [0, 19, 39, 60, 80]
    assert halves.length.tolist() == [20, 21, 22, 21, 21]
    again = halves.halve(20)
    assert again.first.tolist() == halves.first.tolist()
    assert again.length.tolist() == halves.length.tolist()
