import numpy as np

from lagsplat.chart.smooth import smooth


def test_segments_do_not_leak_into_each_other() -> None:
    series = np.zeros((40, 1))
    series[20:] = 5.0
    got = smooth(series, sigma_frames=2.0, segments=((0, 20), (20, 40)))
    np.testing.assert_array_equal(got, series)


def test_kernel_is_a_gaussian_cut_at_four_sigma() -> None:
    series = np.zeros((41, 1))
    series[20] = 1.0
    got = smooth(series, sigma_frames=2.0, segments=((0, 41),))[:, 0]
    taps = np.exp(-0.5 * (np.arange(-8, 9) / 2.0) ** 2)
    np.testing.assert_allclose(got[12:29], taps / taps.sum(), atol=1e-12)
    assert got[:12].sum() == 0.0


def test_edges_are_repeated_and_nothing_is_written_in_place() -> None:
    series = np.linspace(1.0, 2.0, 30)[:, None]
    before = series.copy()
    got = smooth(series, sigma_frames=1.0, segments=((0, 30),))
    np.testing.assert_array_equal(series, before)
    assert got[0, 0] > series[0, 0]
    np.testing.assert_allclose(got[5:25], series[5:25], atol=1e-12)


def test_no_columns_and_no_smoothing_pass_through() -> None:
    assert smooth(np.zeros((5, 0)), sigma_frames=1.0, segments=((0, 5),)).shape == (5, 0)
    series = np.arange(6.0)[:, None]
    np.testing.assert_array_equal(smooth(series, sigma_frames=0.0, segments=((0, 6),)), series)
