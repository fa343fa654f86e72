"""Measurement noise of a recorded motion, and local polynomials that smooth it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.stats import chi2

from lagsplat.diagnose.core.config import NOISE_ESTIMATION
from lagsplat.io.trajectory.trajectory import Trajectory

CHUNK_SAMPLES = 4096  # samples fitted at once, which bounds memory


@dataclass(frozen=True)
class LocalFit:
    """Smoothed coordinates, their rates [1/s] and accelerations [1/s^2] at every sample."""

    q: Float64[np.ndarray, "T d"]
    v: Float64[np.ndarray, "T d"]
    a: Float64[np.ndarray, "T d"]
    rate_gain: Float64[np.ndarray, " T"]  # standard deviation of a rate over that of white noise [1/s]


def fit_locally(motion: Trajectory, *, half_width: int) -> LocalFit:
    """Fit a cubic through the ``2 half_width + 1`` samples nearest to each, never across a clip's border.

    Times may be uneven. Near its border a clip's window is one-sided; a clip of fewer samples than a window
    is fitted as a whole, by a polynomial of degree three or, for fewer than four samples, lower.

    Raises:
        ValueError: a half width below 2.

    Source: local polynomial regression, Fan and Gijbels 1996, chapter 3.
    """
    if half_width < 2:
        raise ValueError(f"half_width is {half_width}; a cubic with a sample to spare needs at least 2")
    return _fit_clips(motion, [half_width] * len(motion.segments))


def fit_over_time(motion: Trajectory, *, width_s: float) -> LocalFit:
    """Fit cubics as `fit_locally` does, over ``width_s`` [s] or nine samples, whichever is more."""
    half_widths = []
    for start, stop in motion.segments:
        n = stop - start
        dt_s = (motion.time_s[stop - 1] - motion.time_s[start]) / max(n - 1, 1)
        wanted = max(round(0.5 * width_s / max(dt_s, 1e-12)), 4)
        half_widths.append(min(wanted, (n - 1) // 2) if n > 4 else wanted)
    return _fit_clips(motion, half_widths)


def _fit_clips(motion: Trajectory, half_widths: Sequence[int]) -> LocalFit:
    """Fit each clip in windows of ``2 half_width + 1`` samples."""
    fitted, gain = np.zeros((3, motion.n, motion.d)), np.zeros(motion.n)
    for (start, stop), half_width in zip(motion.segments, half_widths, strict=True):
        width = min(2 * half_width + 1, stop - start)
        degree = min(3, width - 1)
        for first in range(start, stop, CHUNK_SAMPLES):
            at = np.arange(first, min(first + CHUNK_SAMPLES, stop))
            window = np.clip(at - half_width, start, stop - width)[:, None] + np.arange(width)
            offset = motion.time_s[window] - motion.time_s[at][:, None]
            scale = np.abs(offset).max(axis=1)
            scale[scale == 0.0] = 1.0  # a clip of one sample: it has a value and nothing else
            powers = (offset / scale[:, None])[..., None] ** np.arange(degree + 1)
            inverse = np.linalg.inv(np.einsum("nki,nkj->nij", powers, powers))
            terms = inverse @ np.einsum("nki,nkd->nid", powers, motion.q[window])
            for order in range(min(2, degree) + 1):
                fitted[order, at] = max(order, 1) * terms[:, order] / scale[:, None] ** order
            if degree:
                gain[at] = np.sqrt(inverse[:, 1, 1]) / scale
    q, v, a = fitted
    return LocalFit(q, v, a, gain)


@dataclass(frozen=True)
class MeasurementNoise:
    """Noise of each coordinate's measurement."""

    sigma: Float64[np.ndarray, " d"]  # standard deviation [the coordinate's unit]
    correlation: Float64[np.ndarray, " d"]  # of neighbouring errors
    step: Float64[np.ndarray, " d"]  # of quantisation [the coordinate's unit], 0 where there is none

    @property
    def known_sigma(self) -> Float64[np.ndarray, " d"]:
        """``sigma``, with zero where it is not known."""
        return np.where(np.isfinite(self.sigma), self.sigma, 0.0)


def measure_noise(motions: Sequence[Trajectory], *, period_s: float | None) -> MeasurementNoise:
    """Measure the noise of motions that one sensor recorded.

    Noise is what no polynomial over part of a period explains. Contrasts of a window that are orthogonal to
    polynomials of degree `NOISE_ESTIMATION.polynomial_degree` are Gaussian with the covariance of a
    first-order autoregression; Student's t reduces the weight of windows with a kink. Correlation is 0 unless
    its log evidence exceeds `NOISE_ESTIMATION.correlated_log_ratio` nats. ``period_s`` is the natural period
    [s]; without it the shortest windows are used. Where motion that is fast against the sampling exceeds the
    polynomials, those of degree `NOISE_ESTIMATION.fast_degree` leave less, and the noise is what they leave.
    Sigma is NaN where no clip has `NOISE_ESTIMATION.min_window` samples; it is at least that of rounding to
    the quantisation step.

    Source: marginal likelihood over contrasts as in REML, Patterson and Thompson 1971,
    doi:10.1093/biomet/58.3.545.
    """
    step = measure_resolution(motions)
    dt_s = np.median([motion.dt_s for motion in motions])
    least = longest = NOISE_ESTIMATION.min_window
    if period_s is not None:
        wanted = NOISE_ESTIMATION.max_window_periods * period_s / dt_s
        longest = int(np.clip(wanted, least, NOISE_ESTIMATION.max_window))
    agreement, usual = NOISE_ESTIMATION.window_agreement, NOISE_ESTIMATION.polynomial_degree
    fast = _estimate_in_windows(motions, least, dt_s, degree=NOISE_ESTIMATION.fast_degree)
    chosen = fast
    for width in sorted({least, longest, (least + longest) // 2}):
        found = _estimate_in_windows(motions, width, dt_s, degree=usual)
        chosen = np.where(found[:, 2:] <= agreement * fast[:, 2:], found, chosen)
    sigma, correlation, _ = chosen.T
    return MeasurementNoise(np.maximum(sigma, step / np.sqrt(12.0)), correlation, step)


def measure_resolution(motions: Sequence[Trajectory]) -> Float64[np.ndarray, " d"]:
    """Steps of the sensor [the coordinate's unit], as the motions name them or as found; 0 without any."""
    known = [motion.resolution for motion in motions if motion.resolution]
    if known:
        return np.max(known, axis=0)
    return np.array([find_quantisation_step(column) for column in np.concatenate([m.q for m in motions]).T])


def find_quantisation_step(values: Float64[np.ndarray, " T"]) -> float:
    """Find the step of which all differences are whole multiples; 0 without one.

    At least three tenths of the values must repeat others. Rounding to decimals of a text is such a step,
    too; compare it with the noise to see whether it matters.
    """
    levels = np.unique(values)
    if len(levels) < 2 or len(levels) > 0.7 * len(values):
        return 0.0
    gaps = np.diff(levels)
    span = float(levels[-1] - levels[0])
    gaps = gaps[gaps > 1e-9 * span]  # the same number, rounded twice
    step = float(gaps.min())
    counts = gaps / step
    exact = np.abs(counts - np.rint(counts)) < 0.05
    return step if exact.mean() > 0.98 and span < 1e5 * step else 0.0


def _estimate_in_windows(
    motions: Sequence[Trajectory], width: int, dt_s: float, *, degree: int
) -> Float64[np.ndarray, "d 3"]:
    """Per coordinate: standard deviation, correlation, and the standard deviation if the noise were white.

    Both deviations are NaN where no clip is as long as a window.
    """
    windows = [
        (motion, slice(first, first + width))
        for motion in motions
        for start, stop in motion.segments
        for first in range(start, stop - width + 1, width)
    ]
    if not windows:
        return np.tile([np.nan, 0.0, np.nan], (motions[0].d, 1))
    count = min(len(windows), NOISE_ESTIMATION.max_windows)
    chosen = [windows[k] for k in np.unique(np.linspace(0, len(windows) - 1, count).astype(int))]
    time = np.stack([motion.time_s[window] for motion, window in chosen]) / dt_s
    values = np.stack([motion.q[window] for motion, window in chosen])
    offset = time - time.mean(axis=1, keepdims=True)
    offset = offset / np.abs(offset).max(axis=1, keepdims=True)
    terms = degree + 1
    # An orthonormal basis (W, K, c) of the complement of polynomials over each window.
    contrasts = np.linalg.qr(offset[..., None] ** np.arange(terms), mode="complete")[0][..., terms:]
    lags = np.abs(time[:, :, None] - time[:, None, :])
    projected = np.einsum("wkc,wkd->dwc", contrasts, values - values.mean(axis=1, keepdims=True))
    rounding = 1e-14 * np.abs(values).max(axis=(0, 1))
    rows = [
        (0.0, 0.0, 0.0) if np.abs(observed).max() <= least else _fit_autoregression(observed, contrasts, lags)
        for observed, least in zip(projected, rounding, strict=True)
    ]
    return np.array(rows)


def _fit_autoregression(
    observed: np.ndarray, contrasts: np.ndarray, lags: np.ndarray
) -> tuple[float, float, float]:
    """Standard deviation and correlation of the likeliest first-order autoregression, and of white noise."""
    scores = []
    size = observed.shape[1]
    even = bool(np.abs(lags - np.rint(lags)).max() < 0.2)
    grid = np.linspace(*NOISE_ESTIMATION.correlation_grid)
    for rho in np.where(np.abs(grid) < 1e-9, 0.0, grid):
        if rho < 0.0 and not even:  # negative correlation alternates, which is defined for even steps only
            continue
        signs = np.where(np.rint(lags) % 2, -1.0, 1.0) if rho < 0 else 1.0
        errors = signs * np.abs(rho) ** lags
        covariance = np.einsum("wkc,wkl,wld->wcd", contrasts, errors, contrasts, optimize=True)
        distance = (observed * np.linalg.solve(covariance, observed[..., None])[..., 0]).sum(axis=1)
        variance = _fit_student_variance(distance, size)
        freedom = NOISE_ESTIMATION.student_t_freedom
        fitted = np.log1p(distance / (freedom * variance)).sum() * (freedom + size) / 2.0
        volume = np.linalg.slogdet(covariance)[1].sum() / 2.0 + observed.size * np.log(variance) / 2.0
        # Noise correlated over more than a window looks like motion: a prior keeps the correlation small.
        prior = 3.0 * np.log1p(-(rho**2))
        scores.append((float(prior - fitted - volume), variance, float(rho)))
    white = next(score for score in scores if score[2] == 0.0)
    best = max(scores)
    chosen = best if best[0] - white[0] > NOISE_ESTIMATION.correlated_log_ratio else white
    # Student's scale is below the variance of Gaussian noise, by a factor that depends on the size only.
    factor = 1.0 / _fit_student_variance(chi2.ppf((np.arange(2000) + 0.5) / 2000, size), size)
    return float(np.sqrt(chosen[1] * factor)), chosen[2], float(np.sqrt(white[1] * factor))


def _fit_student_variance(distance: np.ndarray, size: int) -> float:
    """Scale of Student's t that makes squared distances (W,) likeliest, by reweighting."""
    # Where most windows are exactly at rest the scale goes to zero; the floor avoids a division by zero.
    floor = 1e-12 * float(distance.mean()) / size
    variance = max(float(np.median(distance)) / size, floor)
    freedom = NOISE_ESTIMATION.student_t_freedom
    for _ in range(50):
        weight = (freedom + size) / (freedom + distance / variance)
        following = max(float((weight * distance).mean()) / size, floor)
        if abs(following - variance) < 1e-6 * variance:
            break
        variance = following
    return variance
