"""Gaussian smoothing of series, never across a cut."""

from collections.abc import Sequence

from scipy.ndimage import gaussian_filter1d

from lagsplat.shapes import Series


def smooth(series: Series, *, sigma_frames: float, segments: Sequence[tuple[int, int]]) -> Series:
    """Each column smoothed by a Gaussian of ``sigma_frames``, cut at 4 sigma, every segment on its own.

    The first and the last sample of a segment are repeated beyond its ends. The filter is not causal.
    ``sigma_frames = 0`` returns a copy. Samples outside every segment are returned as they are.
    """
    smoothed = series.copy()
    if sigma_frames == 0.0 or series.shape[1] == 0:
        return smoothed
    for start, stop in segments:
        smoothed[start:stop] = gaussian_filter1d(
            series[start:stop], sigma_frames, axis=0, mode="nearest", truncate=4.0
        )
    return smoothed
