"""Measurement noise of a recorded motion, and local polynomials that smooth it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
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


def fit_over_time(motion: Trajectory, *, width_s: float) -> LocalFit:
    """Fit a cubic around each sample, over ``width_s`` [s] or nine samples, whichever is more.

    It never reaches across a clip's border, and times may be uneven. Near its border a clip's window is
    one-sided; a clip of fewer samples than a window is fitted as a whole, by a polynomial of degree three or,
    for fewer than four samples, lower.

    Source: local polynomial regression, Fan and Gijbels 1996, chapter 3.
    """
    fitted, gain = np.zeros((3, motion.n, motion.d)), np.zeros(motion.n)
    for start, stop in motion.segments:
        n = stop - start
        dt_s = (motion.time_s[stop - 1] - motion.time_s[start]) / max(n - 1, 1)
        half_width = max(round(0.5 * width_s / max(dt_s, 1e-12)), 4)
        half_width = min(half_width, (n - 1) // 2) if n > 4 else half_width
        width = min(2 * half_width + 1, n)
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

    Noise is what no polynomial over a window explains: contrasts orthogonal to the polynomials are Gaussian
    with the covariance of a first-order autoregression, Student's t reducing the weight of windows with a
    kink. Noise that lasts shows in windows that are long for the degree of their polynomials, and so does
    motion; the longest windows without motion are taken. Motion is left where the next
    `NOISE_ESTIMATION.guard_degrees` polynomials are larger than the noise of those of higher degree,
    continued down to them, makes likely. A window of one natural period ``period_s`` [s] takes polynomials of
    degree `NOISE_ESTIMATION.degrees_per_period` or more.

    Where all windows hold motion, or without a period, noise is white, and what polynomials of degree
    `NOISE_ESTIMATION.fast_degree` leave in the shortest windows. Sigma is NaN where no clip is as long as
    these; it is at least that of rounding to the quantisation step.

    Source: marginal likelihood over contrasts as in REML, Patterson and Thompson 1971,
    doi:10.1093/biomet/58.3.545.
    """
    step = measure_resolution(motions)
    dt_s = float(np.median([motion.dt_s for motion in motions]))
    sigma, correlation = np.full(motions[0].d, np.nan), np.zeros(motions[0].d)
    for width, degree in _list_window_shapes(0.0 if period_s is None else period_s / dt_s):
        unknown = np.flatnonzero(np.isnan(sigma))
        if not len(unknown):
            break
        windows = _cut_windows(motions, width, dt_s)
        if windows is None or len(windows.values) < NOISE_ESTIMATION.min_windows:
            continue
        models = _list_noise_models(windows.offset, degree)
        for i in unknown:
            fit = _fit_autoregression(windows.values[..., i], models)
            if fit is not None:
                sigma[i], correlation[i] = fit
    shortest = _cut_windows(motions, NOISE_ESTIMATION.min_window, dt_s)
    if shortest is not None:
        basis = _compute_contrasts(shortest.offset, NOISE_ESTIMATION.fast_degree)
        contrasts = np.einsum("wkc,wkd->dwc", basis, shortest.values)
        for i in np.flatnonzero(np.isnan(sigma)):
            sigma[i] = np.sqrt(_fit_gaussian_variance((contrasts[i] ** 2).sum(axis=1), basis.shape[-1]))
    return MeasurementNoise(np.maximum(sigma, step / np.sqrt(12.0)), correlation, step)


def measure_residual_noise(
    times_s: Sequence[Float64[np.ndarray, " L"]],
    residuals: Sequence[Float64[np.ndarray, "L d"]],
    *,
    period_s: float,
) -> Float64[np.ndarray, " d"]:
    """Standard deviation of the noise in what a simulator leaves of its windows; 0 where it is not known.

    A simulator that lacks something still takes most of the motion away. What is left takes polynomials of a
    lower degree, `NOISE_ESTIMATION.residual_share` of a motion's, and leaves noise that lasts longer.
    """
    windows = [
        Trajectory(time_s=time_s, q=residual, u=np.zeros((len(time_s), 0)))
        for time_s, residual in zip(times_s, residuals, strict=True)
    ]
    return measure_noise(windows, period_s=period_s / NOISE_ESTIMATION.residual_share).known_sigma


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


def _list_window_shapes(samples_per_period: float) -> list[tuple[int, int]]:
    """Samples and degrees of the windows that noise is sought in, those that are longest for their degree
    first."""
    shapes = [
        (width, degree)
        for width in NOISE_ESTIMATION.window_widths
        for degree in NOISE_ESTIMATION.window_degrees
        if degree * samples_per_period >= NOISE_ESTIMATION.degrees_per_period * width
        and width - degree - 1 >= 2 * NOISE_ESTIMATION.guard_degrees
    ]
    return sorted(
        shapes, key=lambda shape: shape[0] / (shape[1] + NOISE_ESTIMATION.guard_degrees), reverse=True
    )


@dataclass(frozen=True)
class _Windows:
    """Windows of ``K`` samples, at the same times (w = 1) or each at its own (w = W)."""

    offset: Float64[np.ndarray, "w K"]  # times from the middle [samples]
    values: Float64[np.ndarray, "W K d"]  # from their mean


def _cut_windows(motions: Sequence[Trajectory], width: int, dt_s: float) -> _Windows | None:
    """At most `NOISE_ESTIMATION.max_windows`, evenly over the motions; None where no clip is as long as one.

    Where half of them or more are evenly sampled, those alone. Otherwise each has times, and so a matrix, of
    its own, and of windows longer than the shortest the fewer are taken, by the squares of their lengths.
    """
    windows = [
        (motion, slice(first, first + width))
        for motion in motions
        for start, stop in motion.segments
        for first in range(start, stop - width + 1, width)
    ]
    if not windows:
        return None
    chosen = _spread(len(windows), NOISE_ESTIMATION.max_windows)
    time = np.stack([windows[k][0].time_s[windows[k][1]] for k in chosen]) / dt_s
    values = np.stack([windows[k][0].q[windows[k][1]] for k in chosen])
    values = values - values.mean(axis=1, keepdims=True)
    offset, regular = time - time.mean(axis=1, keepdims=True), np.arange(width) - 0.5 * (width - 1)
    even = np.abs(offset - regular).max(axis=1) < 0.1
    if even.mean() >= 0.5:
        return _Windows(regular[None], values[even])
    fewer = NOISE_ESTIMATION.max_windows * (NOISE_ESTIMATION.min_window / width) ** 2
    few = _spread(len(offset), max(int(fewer), NOISE_ESTIMATION.min_windows))
    return _Windows(offset[few], values[few])


def _spread(n: int, most: int) -> Int64[np.ndarray, " k"]:
    """At most ``most`` of ``n`` numbers, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))


def _compute_contrasts(offset: Float64[np.ndarray, "w K"], degree: int) -> Float64[np.ndarray, "w K c"]:
    """Orthonormal contrasts of samples at ``offset``: no polynomial up to ``degree`` shows in them.

    The first `NOISE_ESTIMATION.guard_degrees` are those of the next degrees.
    """
    scaled = offset / np.abs(offset).max(axis=1, keepdims=True)
    highest = min(degree + NOISE_ESTIMATION.guard_degrees, offset.shape[1] - 1)
    polynomials = np.polynomial.legendre.legvander(scaled, highest)
    return np.linalg.qr(polynomials, mode="complete")[0][..., degree + 1 :]


@dataclass(frozen=True)
class _NoiseModel:
    """Contrasts of an autoregression of unit variance, and what its others tell of the guard contrasts."""

    correlation: float  # of neighbouring samples
    basis: Float64[np.ndarray, "w K c"]  # contrasts
    precision: Float64[np.ndarray, "w r r"]  # inverse covariance of all but the guard contrasts
    log_volume: Float64[np.ndarray, " w"]  # log determinant of their covariance
    gain: Float64[np.ndarray, "w g r"]  # expected guard contrasts, given the others
    guard_precision: Float64[
        np.ndarray, "w g g"
    ]  # inverse covariance of the guard contrasts, given the others


def _list_noise_models(offset: Float64[np.ndarray, "w K"], degree: int) -> list[_NoiseModel]:
    """Models of white noise, first, and of correlated noise."""
    basis = _compute_contrasts(offset, degree)
    lags = np.abs(offset[:, :, None] - offset[:, None, :])
    first, last, count = NOISE_ESTIMATION.correlation_range
    # correlations near one differ by the time that they last; negative ones alternate, for even steps only
    positive = 1.0 - np.geomspace(1.0 - first, 1.0 - last, count)
    signs = np.where(np.rint(lags) % 2, -1.0, 1.0) if len(offset) == 1 else None
    grid = [
        0.0,
        *positive,
        *(-positive[positive <= NOISE_ESTIMATION.max_alternation] if signs is not None else ()),
    ]
    models, g = [], NOISE_ESTIMATION.guard_degrees
    for rho in grid:
        errors = abs(rho) ** lags * (signs if rho < 0.0 else 1.0)
        covariance = np.swapaxes(basis, 1, 2) @ errors @ basis
        precision, cross = np.linalg.inv(covariance[:, g:, g:]), covariance[:, :g, g:]
        gain = cross @ precision
        given = covariance[:, :g, :g] - gain @ np.swapaxes(cross, 1, 2)
        volume = np.linalg.slogdet(covariance[:, g:, g:])[1]
        models.append(_NoiseModel(float(rho), basis, precision, volume, gain, np.linalg.inv(given)))
    return models


def _fit_autoregression(
    values: Float64[np.ndarray, "W K"], models: Sequence[_NoiseModel]
) -> tuple[float, float] | None:
    """Standard deviation and correlation of the likeliest noise; None if windows hold motion.

    Noise is white unless the log evidence of a correlation exceeds `NOISE_ESTIMATION.correlated_log_ratio`.
    """
    contrasts = (values[:, None] @ models[0].basis)[:, 0]
    g = NOISE_ESTIMATION.guard_degrees
    guards, others = contrasts[:, :g], contrasts[:, g:]
    if np.abs(contrasts).max() <= 1e-14 * np.abs(values).max():
        return 0.0, 0.0
    scores, freedom = [], NOISE_ESTIMATION.student_t_freedom
    for model in models:
        distance = _compute_distance(others, model.precision)
        variance = _fit_student_variance(distance, others.shape[1])
        fitted = np.log1p(distance / (freedom * variance)).sum() * (freedom + others.shape[1]) / 2.0
        volume = len(values) * model.log_volume.mean() / 2.0 + others.size * np.log(variance) / 2.0
        # Noise correlated over more than a window looks like motion: a prior keeps the correlation small.
        scores.append(3.0 * np.log1p(-(model.correlation**2)) - fitted - volume)
    best = int(np.argmax(scores))
    model = models[best if scores[best] - scores[0] > NOISE_ESTIMATION.correlated_log_ratio else 0]
    variance = _fit_gaussian_variance(_compute_distance(others, model.precision), others.shape[1])
    unexpected = guards - (others[:, None] @ np.swapaxes(model.gain, 1, 2))[:, 0]
    excess = _fit_gaussian_variance(_compute_distance(unexpected, model.guard_precision), g)
    by_chance = 1.0 + 2.0 / np.sqrt(2.0 * guards.size)  # two standard errors
    if np.sqrt(excess) > NOISE_ESTIMATION.guard_agreement * by_chance * np.sqrt(variance):
        return None
    return float(np.sqrt(variance)), model.correlation


def _compute_distance(
    values: Float64[np.ndarray, "W c"], precision: Float64[np.ndarray, "w c c"]
) -> Float64[np.ndarray, " W"]:
    """Squared Mahalanobis distances of rows from zero."""
    return ((values[:, None] @ precision)[:, 0] * values).sum(axis=1)


def _fit_gaussian_variance(distance: Float64[np.ndarray, " W"], size: int) -> float:
    """Variance of Gaussian noise from squared distances, by Student's scale: below the variance, by a factor
    that depends on the size only."""
    if not distance.any():
        return 0.0
    usual = chi2.ppf((np.arange(2000) + 0.5) / 2000, size)
    return _fit_student_variance(distance, size) / _fit_student_variance(usual, size)


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
