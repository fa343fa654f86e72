"""Frequency of a free oscillation by a windowed spectrum, and the even resampling that it needs."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline

from lagsplat.chart.trajectory import TimeBase

SUB_WINDOWS = 5
SUB_LENGTH = 0.75


@dataclass(frozen=True)
class Peak:
    """Spectral peaks of one window [Hz]; None where the band has no peak.

    ``visible_hz``, the value to quote, is of the projection on the top eigenvector of the metric,
    ``weighted_hz`` of the power summed in the metric. ``uncertainty_hz`` belongs to ``visible_hz``: the
    standard deviation of the estimate over shorter windows inside this one, None if fewer than three peak.
    """

    visible_hz: float | None
    weighted_hz: float | None
    uncertainty_hz: float | None


def find_spectral_peak(
    series: Float64[np.ndarray, "N d"],
    *,
    dt_s: float,
    metric: Float64[np.ndarray, "d d"],
    min_cycles: float,
) -> Peak:
    """Peak frequency of one window, its mean removed, under a symmetric Hann window and without padding.

    The uncertainty comes from five sub-windows of three quarters of the length: the effects of their smaller
    length and of their overlap nearly cancel, and it includes the drift of the frequency.

    Args:
        series, dt_s: states (N, d), evenly spaced (see `resample_evenly`), and their spacing [s].
        metric, min_cycles: weight of the coordinates (d, d), and fewest cycles per window of a bin.

    Source: paper, Metrics, the windowed spectral estimator.
    """
    visible_mode = np.linalg.eigh(metric)[1][:, [-1]]

    def visible_peak(part: np.ndarray) -> float | None:
        power = np.abs(_transform(part @ visible_mode)[:, 0]) ** 2
        return find_peak_frequency(power, len(part) * dt_s, min_cycles)

    length = round(SUB_LENGTH * len(series))
    offsets = np.linspace(0, len(series) - length, SUB_WINDOWS).round().astype(int)
    inner = [peak for o in offsets if (peak := visible_peak(series[o : o + length])) is not None]
    spectrum = _transform(series)
    weighted = np.einsum("fi,ij,fj->f", spectrum.conj(), metric, spectrum).real
    return Peak(
        visible_hz=visible_peak(series),
        weighted_hz=find_peak_frequency(weighted, len(series) * dt_s, min_cycles),
        uncertainty_hz=float(np.std(inner, ddof=1)) if len(inner) >= 3 else None,
    )


def find_peak_frequency(power: Float64[np.ndarray, " F"], span_s: float, min_cycles: float) -> float | None:
    """Frequency [Hz] of the strongest allowed bin, refined by a parabola through the log power.

    The refinement is used only where the parabola is concave and moves by at most half a bin. None where the
    strongest allowed bin is the flank of power below the band (a drift, a strongly damped motion), or where
    there is no motion at all.
    """
    first = max(int(np.ceil(min_cycles)), 1)
    if len(power) < first + 2 or power[first:].max() <= 0.0:
        return None
    bin_ = first + int(np.argmax(power[first:]))
    if power[bin_ - 1] > power[bin_]:
        return None
    shift = 0.0
    if bin_ + 1 < len(power) and power[bin_ - 1 : bin_ + 2].min() > 0.0:
        left, centre, right = np.log(power[bin_ - 1 : bin_ + 2])
        curvature = left - 2.0 * centre + right
        vertex = 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
        shift = vertex if abs(vertex) <= 0.5 else 0.0
    return float((bin_ + shift) / span_s)


def _transform(series: np.ndarray) -> np.ndarray:
    window = np.hanning(len(series))[:, None]
    return np.fft.rfft((series - series.mean(axis=0)) * window, axis=0)


def resample_evenly(series: Float64[np.ndarray, "N d"], clock: TimeBase, *, start: int) -> np.ndarray:
    """Resample a series to spacing ``dt_s``, (M, d), from the frame ``start``; unchanged on an even clock.

    Uses a cubic spline through the frames at their true times. The span is kept; the length may differ.
    """
    if clock.time_s is None:
        return series
    true_s = clock.instants_s(start, len(series))
    even_s = clock.dt_s * np.arange(int(true_s[-1] / clock.dt_s + 1e-6) + 1)
    return CubicSpline(true_s, series)(np.minimum(even_s, true_s[-1]))
