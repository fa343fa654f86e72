import numpy as np
import pytest

from lagsplat.chart.trajectory import TimeBase, read_time_base

STENCILS = ((1, 2), (-1, 1), (-2, -1), (-2, -1, 1, 2))


def jittered(n: int) -> np.ndarray:
    """A clock of 0.02 s with a fifth of jitter and dropped frames."""
    rng = np.random.default_rng(0)
    return 0.02 * (np.arange(n) + 0.2 * rng.uniform(-1, 1, n))[rng.uniform(size=n) > 0.05]


@pytest.mark.parametrize("stencil", STENCILS)
def test_slopes_are_exact_up_to_their_order_on_true_times(stencil: tuple[int, ...]) -> None:
    time_s = jittered(60)
    clock, at = read_time_base(time_s, ((0, len(time_s)),)), np.arange(2, len(time_s) - 2)
    order = len(stencil)
    slope = clock.slope((time_s**order)[:, None], at, stencil)[:, 0]
    np.testing.assert_allclose(slope, order * time_s[at] ** (order - 1), rtol=1e-9, atol=1e-12)
    by_frames = TimeBase(clock.dt_s).slope((time_s**order)[:, None], at, stencil)[:, 0]
    assert np.abs(by_frames - slope).max() > 0.05 * np.abs(slope).max()


def test_on_an_even_clock_slopes_are_the_textbook_differences() -> None:
    q, h, at = np.random.default_rng(1).normal(size=(20, 3)), 1001 / 60000, np.arange(2, 18)
    known = {
        (1, 2): (-3 * q[at] + 4 * q[at + 1] - q[at + 2]) / (2 * h),
        (-1, 1): (q[at + 1] - q[at - 1]) / (2 * h),
        (-2, -1, 1, 2): (8 * (q[at + 1] - q[at - 1]) - (q[at + 2] - q[at - 2])) / (12 * h),
    }
    for clock in (read_time_base(h * np.arange(20), ((0, 20),)), TimeBase(h, h * np.arange(20))):
        for stencil, slope in known.items():
            np.testing.assert_allclose(clock.slope(q, at, stencil), slope, rtol=1e-12, atol=1e-11)


def test_a_clock_that_only_rounds_is_even_and_gives_plain_numbers() -> None:
    time_s = 1.7e5 + 1001 / 60000 * np.arange(50)
    clock = read_time_base(time_s, ((0, 50),))
    assert clock.time_s is None
    assert clock.steps_s(np.array([3, 5]), 9) == clock.elapsed_s(np.array([3]), 1) == clock.dt_s
    time_s[20:] += 1e-3
    uneven = read_time_base(time_s, ((0, 50),))
    np.testing.assert_allclose(uneven.steps_s(np.array([18]), 4)[0], np.diff(time_s[18:22]))
    assert uneven.instants_s(19, 2)[1] == pytest.approx(1001 / 60000 + 1e-3)


def test_times_between_clips_do_not_count() -> None:
    time_s = np.concatenate([k + 0.1 * np.arange(2) for k in range(0, 10, 2)])
    pairs = tuple((a, a + 2) for a in range(0, 10, 2))
    clock = read_time_base(time_s, pairs)
    assert clock.dt_s == pytest.approx(0.1)
    assert clock.time_s is None
    with pytest.raises(ValueError, match=r"no two of 10 frame\(s\) share a clip"):
        read_time_base(time_s, tuple((a, a + 1) for a in range(10)))
