"""Means of several samples of a log, turned into values that act as the log does."""

import numpy as np
import pytest

from lagsplat.io.trajectory.logged_inputs import LoggedInputs, average_groups

N = 4  # samples of a mean
TIME_S = np.arange(40) * 0.1
MIDDLES_S = TIME_S.reshape(-1, N).mean(axis=1)


def logged(
    values: np.ndarray, *, held: bool, clips: tuple[tuple[int, int], ...] = ((0, 40),)
) -> LoggedInputs:
    return LoggedInputs(TIME_S, values, clips, N, held)


def test_a_parabola_is_met_in_the_middle_of_its_means() -> None:
    parabola = np.stack([TIME_S**2, 1.0 - 3.0 * TIME_S], axis=1)
    found = average_groups(TIME_S, parabola, ((0, 40),), N)
    np.testing.assert_allclose(found, np.stack([MIDDLES_S**2, 1.0 - 3.0 * MIDDLES_S], 1), atol=1e-12)


@pytest.mark.parametrize("held", [False, True])
def test_what_does_not_change_stays(held: bool) -> None:
    level = np.full((40, 1), 2.5)
    np.testing.assert_allclose(logged(level, held=held).average(level), np.full((10, 1), 2.5))


def test_corners_of_straight_lines_have_the_means_of_the_log() -> None:
    """Straight lines through the corners, averaged over each group, are the log's means."""
    parabola = TIME_S[:, None] ** 2
    corners = logged(parabola, held=False).average(parabola)
    fine = np.linspace(-0.2, 0.2, 4001)[:, None] + MIDDLES_S[1:-1]
    lines = np.interp(fine, MIDDLES_S, corners[:, 0]).mean(axis=0)
    spread = TIME_S[:N].var()
    means = parabola.reshape(-1, N).mean(axis=1)[1:-1]
    # four instants have 15/16 of the variance of a span without gaps
    assert lines == pytest.approx(means, abs=0.25 * spread)
    assert np.abs(lines - MIDDLES_S[1:-1] ** 2).min() > 0.5 * spread


def test_a_held_input_counts_until_the_next_sample() -> None:
    step = np.where(np.arange(40) < 18, 0.0, 1.0)[:, None]
    found = logged(step, held=True).average(step)[:, 0]
    assert found[3] == 0.0
    assert found[5] == 1.0
    assert 0.0 < found[4] < 1.0
    assert np.all(np.diff(found) >= 0.0)


def test_clips_do_not_mix() -> None:
    jump = np.where(np.arange(40) < 20, 0.0, 1.0)[:, None]
    for held in (False, True):
        found = logged(jump, held=held, clips=((0, 20), (20, 40))).average(jump)[:, 0]
        assert found == pytest.approx(np.repeat([0.0, 1.0], 5))


def test_fewer_than_four_means_are_not_bent() -> None:
    short = TIME_S[:12, None] ** 2
    found = average_groups(TIME_S[:12], short, ((0, 12),), N)
    np.testing.assert_array_equal(found, short.reshape(3, N).mean(axis=1)[:, None])
