import numpy as np
import pytest

from lagsplat.chart.trajectory import TimeBase, smooth_trajectory

FRAMES = TimeBase(1.0)


def test_segments_do_not_leak_into_each_other() -> None:
    series = np.zeros((40, 1))
    series[20:] = 5.0
    got = smooth_trajectory(series, sigma_frames=2.0, segments=((0, 20), (20, 40)), clock=FRAMES)
    np.testing.assert_array_equal(got, series)


def test_kernel_is_a_twiced_gaussian_cut_at_four_sigma() -> None:
    series = np.zeros((61, 1))
    series[30] = 1.0
    got = smooth_trajectory(series, sigma_frames=2.0, segments=((0, 61),), clock=FRAMES)[:, 0]
    taps = np.exp(-0.5 * (np.arange(-8, 9) / 2.0) ** 2)
    taps /= taps.sum()
    np.testing.assert_allclose(got[14:47], 2 * np.pad(taps, 8) - np.convolve(taps, taps), atol=1e-12)
    assert got[:14].sum() == 0.0


@pytest.mark.parametrize("shaken", [0.0, 0.2])
def test_a_swing_keeps_its_amplitude_and_noise_does_not(shaken: float) -> None:
    """At a twentieth of a period: a Gaussian takes 5 % away. On an even clock and on one that is not."""
    rng = np.random.default_rng(3)
    time_s = 0.1 * (np.arange(400) + rng.uniform(-shaken, shaken, 400))
    clock = TimeBase(0.1, time_s if shaken else None)
    swing, noise = np.sin(2 * np.pi * time_s / 2.0)[:, None], rng.normal(size=(400, 1))
    kept, left = (
        smooth_trajectory(series, sigma_frames=1.0, segments=((0, 400),), clock=clock)
        for series in (swing, noise)
    )
    assert kept.std() == pytest.approx(swing.std(), rel=0.004)
    assert np.abs(kept - swing)[10:-10].max() < 0.015
    assert left.std() < 0.75 * noise.std()


def test_a_steady_motion_stays_steady_to_its_ends_and_nothing_is_written_in_place() -> None:
    series = np.linspace(1.0, 2.0, 30)[:, None]
    before = series.copy()
    got = smooth_trajectory(series, sigma_frames=2.0, segments=((0, 12), (12, 30)), clock=FRAMES)
    np.testing.assert_array_equal(series, before)
    np.testing.assert_allclose(got, series, atol=1e-12)


def test_segments_shorter_than_the_filter_are_smoothed() -> None:
    series = np.array([[1.0], [3.0], [2.0], [7.0]])
    got = smooth_trajectory(series, sigma_frames=3.0, segments=((0, 3), (3, 4)), clock=FRAMES)
    assert np.isfinite(got).all()
    assert got[3, 0] == 7.0


def test_no_columns_and_no_smoothing_pass_through() -> None:
    assert smooth_trajectory(np.zeros((5, 0)), sigma_frames=1.0, segments=((0, 5),), clock=FRAMES).shape == (
        5,
        0,
    )
    series = np.arange(6.0)[:, None]
    np.testing.assert_array_equal(
        smooth_trajectory(series, sigma_frames=0.0, segments=((0, 6),), clock=FRAMES), series
    )


def test_true_times_reduce_to_frames_on_an_even_clock() -> None:
    series, time_s = np.random.default_rng(0).normal(size=(50, 2)), 0.02 * np.arange(50)
    cuts = ((0, 20), (20, 50))
    plain, timed = (
        smooth_trajectory(series, sigma_frames=1.5, segments=cuts, clock=TimeBase(0.02, instants))
        for instants in (None, time_s)
    )
    np.testing.assert_allclose(timed, plain, atol=1e-12)


def test_an_uneven_clock_does_not_shake_a_steady_motion() -> None:
    rng = np.random.default_rng(1)
    time_s = 0.02 * (np.arange(80) + rng.uniform(-0.2, 0.2, 80))[rng.uniform(size=80) > 0.05]
    segments = ((0, len(time_s)),)
    timed, framed = (
        smooth_trajectory(
            time_s[:, None], sigma_frames=1.0, segments=segments, clock=TimeBase(0.02, instants)
        )[:, 0]
        for instants in (time_s, None)
    )
    inner = slice(5, -5)
    np.testing.assert_allclose(timed[inner], time_s[inner], atol=1e-12)
    assert np.abs(framed - time_s)[inner].max() > 1e-3


def test_a_frame_alone_in_time_stays() -> None:
    time_s = np.array([0.0, 0.02, 0.04, 9.0, 18.0, 18.02, 18.04])
    series = np.arange(7.0)[:, None] ** 2
    got = smooth_trajectory(series, sigma_frames=1.0, segments=((0, 7),), clock=TimeBase(0.02, time_s))
    assert got[3] == series[3]
    assert np.isfinite(got).all()
