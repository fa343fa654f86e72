"""Smoothing of series that leaves a motion its amplitude, never across a cut."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from lagsplat.chart.clock import Clock
from lagsplat.shapes import Series

TRUNCATE = 4.0


def smooth(
    series: Series,
    *,
    sigma_frames: float,
    segments: Sequence[tuple[int, int]],
    clock: Clock | None = None,
) -> Series:
    """Each column smoothed by a Gaussian of ``sigma_frames`` and, likewise, what that took away put back.

    A Gaussian alone shrinks a swing of 20 sigma a period by 5 %, and with it what a law learns of how its
    frequency depends on amplitude; twiced, it shrinks it by 0.2 %. It is cut at 4 sigma, every segment on its
    own. Beyond its ends a segment goes on turned about them, so that a steady motion stays steady: repeating
    the last sample would slow it down. The filter is not causal.
    ``sigma_frames = 0`` returns a copy. Samples outside every segment are returned as they are. On an uneven
    ``clock`` sigma is that many median spacings, the weights are those of the true times, and the value is
    that of a line fitted with them; on an even one this is the plain filter.

    Source: twicing, Tukey 1977, "Exploratory Data Analysis", section 16.
    """
    if sigma_frames == 0.0 or series.shape[1] == 0:
        return series.copy()
    once = _blurred(series, sigma_frames, segments, clock)
    return once + _blurred(series - once, sigma_frames, segments, clock)


def _blurred(
    series: Series, sigma_frames: float, segments: Sequence[tuple[int, int]], clock: Clock | None
) -> Series:
    smoothed = series.copy()
    for start, stop in segments:
        part = slice(start, stop)
        if clock is None or clock.time_s is None:
            reach = int(TRUNCATE * sigma_frames + 0.5)
            longer = _beyond(series[part], reach)
            found = gaussian_filter1d(longer, sigma_frames, axis=0, truncate=TRUNCATE)
            smoothed[part] = found[reach : len(longer) - reach]
        else:
            smoothed[part] = _local_lines(series[part], clock.time_s[part] / clock.dt_s, sigma_frames)
    return smoothed


def _local_lines(series: Series, time: np.ndarray, sigma: float) -> Series:
    """Values at ``time`` (in median spacings) of lines fitted around each sample with Gaussian weights."""
    reach = int(TRUNCATE * sigma + 0.5)
    time = _beyond(time[:, None], reach)[:, 0]
    padded = _beyond(series, reach)
    taps = np.arange(len(series))[:, None] + np.arange(2 * reach + 1)
    x = time[taps] - time[reach : len(time) - reach, None]
    weight = np.exp(-0.5 * (x / sigma) ** 2)
    # A plain weighted mean belongs to the mean of its times, which on an uneven clock is not the frame's own:
    # it would turn the jitter of the clock into jitter of the state. The line takes that out; weights in
    # frames would have the same fault, and a length that changes with the clock on top.
    zeroth, first, second = (np.sum(weight * x**power, axis=1, keepdims=True) for power in range(3))
    spread = zeroth * second - first**2
    lone = spread <= 1e-12 * zeroth**2
    share = np.where(lone, x == 0.0, weight * (second - first * x) / np.where(lone, 1.0, spread))
    return np.einsum("tk,tkm->tm", share, padded[taps])


def _beyond(series: np.ndarray, reach: int) -> np.ndarray:
    """``series`` with ``reach`` more samples at either end, point reflections of those inside."""
    around = ((reach, reach), (0, 0))
    if len(series) == 1:
        return np.pad(series, around, mode="edge")
    return np.pad(series, around, mode="reflect", reflect_type="odd")
