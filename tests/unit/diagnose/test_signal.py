"""Inputs at the stages of a rollout: interpolated or held, and never from another clip."""

import numpy as np
import pytest

from lagsplat.diagnose.effects.actuation import input_backlash, input_delay, input_lag
from lagsplat.diagnose.effects.measurement import time_offset
from lagsplat.diagnose.estimation.dataset import Dataset, build_input_signals, compute_stage_times

TIME = np.array([0.0, 0.1, 0.25, 0.3, 0.0, 0.2, 0.3])
U = np.array([1.0, 3.0, -2.0, 0.5, 10.0, 12.0, 11.0])
CLIPS = np.array([[0, 4], [4, 7]])


def record() -> Dataset:
    blank = np.zeros((7, 1))
    return Dataset(TIME, blank, blank, U[:, None], CLIPS, ("a", "b"), np.array([0, 1]), (0.0, 0.0))


def test_stages_are_the_beginning_middle_and_end_of_every_substep() -> None:
    time, clip = compute_stage_times(record(), 2)
    assert time[1] == pytest.approx(np.array([[0.1, 0.1375, 0.175], [0.175, 0.2125, 0.25]]))
    assert np.ptp(time[3]) == 0.0  # the last frame of a clip leads nowhere
    assert clip.tolist() == [0, 0, 0, 0, 1, 1, 1]


def test_between_samples_an_input_is_a_line_or_held() -> None:
    straight = build_input_signals(record(), steps=2, held=False)[0].values.reshape(7, 2, 3)
    assert straight[0].ravel().tolist() == pytest.approx([1.0, 1.5, 2.0, 2.0, 2.5, 3.0])
    assert straight[4, 0, 0] == 10.0
    held = build_input_signals(record(), steps=2, held=True)[0].values.reshape(7, 2, 3)
    for n in (0, 1, 2, 4, 5):
        assert (held[n] == U[n]).all()


@pytest.mark.parametrize("held", [False, True])
def test_a_delayed_input_is_the_earlier_one_and_does_not_look_into_another_clip(held: bool) -> None:
    signal = build_input_signals(record(), steps=2, held=held)[0]
    late = input_delay.change(signal, np.array([[0.0], [0.12]])).reshape(2, 7, 2, 3)
    assert np.array_equal(late[0].ravel(), signal.values)
    assert late[1, 1, 0, 0] == 1.0  # before the first sample, that sample
    assert late[1, 4, 0, 0] == 10.0
    assert late[1, 2, 0, 0] == pytest.approx(3.0 if held else 3.0 - 5.0 * 0.03 / 0.15)


def test_motion_that_is_stamped_late_looks_like_a_late_input() -> None:
    signal = build_input_signals(record(), steps=2, held=False)[0]
    late = input_delay.change(signal, np.array([[0.12]]))
    assert np.array_equal(time_offset.change(signal, np.array([[-0.12]])), late)


def test_a_lag_answers_a_held_step_as_an_exponential() -> None:
    time = 0.05 * np.arange(20)
    u = np.where(time < 0.099, 0.0, 2.0)[:, None]
    blank = np.zeros((20, 1))
    whole = Dataset(time, blank, blank, u, np.array([[0, 20]]), ("a",), np.zeros(1, np.int64), (0.0,))
    signal = build_input_signals(whole, steps=3, held=True)[0]
    out = input_lag.change(signal, np.array([[0.2]])).reshape(20, 3, 3)[:, 0, 0]
    assert out == pytest.approx(2.0 * -np.expm1(-np.maximum(time - 0.1, 0.0) / 0.2), abs=1e-5)


def test_play_follows_at_half_its_width_and_forgets_between_clips() -> None:
    signal = build_input_signals(record(), steps=1, held=False)[0]
    out = input_backlash.change(signal, np.array([[2.0, 0.0]]))[0].reshape(7, 3)[:, 0]
    assert out.tolist() == pytest.approx([1.0, 2.0, -1.0, -0.5, 10.0, 11.0, 11.0])
