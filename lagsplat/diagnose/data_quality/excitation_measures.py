"""What a recording excites: amplitudes, speeds, rests and inputs, over its natural period and noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects, label

from lagsplat.diagnose.core.config import EXCITATION
from lagsplat.diagnose.data_quality.noise import LocalFit, MeasurementNoise, fit_locally
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class InputMeasures:
    """Measures of one input."""

    name: str
    moves: bool
    crosses_zero: bool
    small_share: float  # of samples within a fifth of the largest value
    levels: int  # distinct sizes at which it reversed
    low: float  # lower bound of nine tenths of its power, over the natural frequency
    high: float  # upper bound of the same
    steps: int  # sudden changes
    reversals: int  # changes of direction


@dataclass(frozen=True)
class ExcitationMeasures:
    """Measures of a whole recording; of several coordinates, those of the best one."""

    period_s: float
    periods: float
    clips: int
    amplitude_ratio: float  # of large to small swings
    speed_ratio: float  # of the durations of slow to fast half-swings
    reversals: int
    slow_share: float  # of samples below `EXCITATION.slow_rate_share` of the rms rate
    rest_periods: float  # longest rest
    holds: int  # rests at distinct positions
    swing_over_noise: float
    step_over_noise: float  # motion between two samples over the noise
    samples_per_period: float
    inputs: tuple[InputMeasures, ...]

    @property
    def driven(self) -> bool:
        """Whether any input moves."""
        return any(channel.moves for channel in self.inputs)


def measure_excitation(
    motions: Sequence[Trajectory], *, period_s: float, noise: MeasurementNoise
) -> ExcitationMeasures:
    """Measure what the motions of one side excite.

    ``period_s`` is the natural period [s] and ``noise`` that of the measurement.
    """
    dt_s = float(np.median([motion.dt_s for motion in motions]))
    half = int(np.clip(0.08 * period_s / dt_s, 2, 60))
    fits = [fit_locally(motion, half_width=half) for motion in motions]
    sigma = noise.known_sigma
    q = np.concatenate([motion.q - motion.q.mean(axis=0) for motion in motions])
    rate = np.sqrt(np.concatenate([fit.v**2 for fit in fits]).mean(axis=0))
    size = np.maximum(q.std(axis=0), np.finfo(float).tiny)
    best = int(np.argmax(size / np.maximum(sigma, 1e-9 * size)))
    best_noise = max(sigma[best], 1e-9 * size[best])
    swings = [_find_swings(motions, fits, i, sigma[i]) for i in range(q.shape[1])]
    rests = [_find_rests(m, f, rate, sigma, period_s) for m, f in zip(motions, fits, strict=True)]
    slow = np.concatenate([np.abs(fit.v) < EXCITATION.slow_rate_share * rate for fit in fits]).mean(axis=0)
    return ExcitationMeasures(
        period_s=period_s,
        periods=sum(motion.duration_s for motion in motions) / period_s,
        clips=sum(len(motion.segments) for motion in motions),
        amplitude_ratio=max(_compute_quantile_ratio(sizes) for sizes, _ in swings),
        speed_ratio=max(_compute_quantile_ratio(times_s) for _, times_s in swings),
        reversals=max(len(sizes) for sizes, _ in swings),
        slow_share=float(slow.max()),
        rest_periods=max((length for rest in rests for length, _ in rest), default=0.0) / period_s,
        holds=_count_distinct(np.array([place for rest in rests for _, place in rest]), np.ptp(q, axis=0)),
        swing_over_noise=float(min(size[best] / best_noise, 1e6)),
        step_over_noise=float(min(rate[best] * dt_s / best_noise, 1e6)),
        samples_per_period=period_s / dt_s,
        inputs=tuple(_measure_input(motions, i, period_s) for i in range(motions[0].n_u)),
    )


def _find_swings(
    motions: Sequence[Trajectory], fits: Sequence[LocalFit], i: int, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Half the distance between turning points, and the time between them [s], where above the noise."""
    sizes, times_s = [], []
    for motion, fit in zip(motions, fits, strict=True):
        least = EXCITATION.swing_noise_ratio * sigma + 1e-6 * np.ptp(motion.q[:, i])
        for start, stop in motion.segments:
            v = fit.v[start:stop, i]
            turns = start + 1 + np.flatnonzero((v[1:] > 0) != (v[:-1] > 0))
            amplitudes = 0.5 * np.abs(np.diff(fit.q[turns, i]))
            sizes.append(amplitudes[amplitudes > least])
            times_s.append(np.diff(motion.time_s[turns])[amplitudes > least])
    return np.concatenate(sizes), np.concatenate(times_s)


def _compute_quantile_ratio(values: np.ndarray) -> float:
    """Ratio of the upper to the lower decile; 1 with fewer than three values."""
    if len(values) < 3:
        return 1.0
    low, high = np.quantile(values, [1.0 - 0.9, 0.9])
    return float(high / low) if low > 0 else 1.0


def _find_rests(
    motion: Trajectory, fit: LocalFit, rate: np.ndarray, sigma: np.ndarray, period_s: float
) -> list[tuple[float, np.ndarray]]:
    """Duration [s] and position of every rest of at least `EXCITATION.min_rest_periods`."""
    limit = np.maximum(EXCITATION.rest_rate_share * rate, 4.0 * sigma * np.median(fit.rate_gain))
    # Noise that hides the motion must not count as rest.
    limit = np.minimum(limit, 0.3 * rate)
    still = (np.abs(fit.v) < limit).all(axis=1)
    rests = []
    for start, stop in motion.segments:
        for (run,) in find_objects(label(still[start:stop])[0]):
            rest = slice(start + run.start, start + run.stop)
            length_s = float(motion.time_s[rest.stop - 1] - motion.time_s[rest.start])
            if length_s >= EXCITATION.min_rest_periods * period_s:
                rests.append((length_s, np.median(motion.q[rest], axis=0)))
    return rests


def _count_distinct(places: np.ndarray, span: np.ndarray) -> int:
    """Number of places farther apart than `EXCITATION.level_separation` of the range ``span``."""
    kept: list[np.ndarray] = []
    for place in places:
        if all((np.abs(place - other) > EXCITATION.level_separation * span).any() for other in kept):
            kept.append(place)
    return len(kept)


def _measure_input(motions: Sequence[Trajectory], i: int, period_s: float) -> InputMeasures:
    """Measures of input ``i`` of all motions."""
    u = np.concatenate([motion.u[:, i] for motion in motions])
    size, span = float(np.abs(u).max()), float(np.ptp(u))
    name = motions[0].u_names[i]
    if span <= 1e-6 * size or size == 0.0:
        return InputMeasures(name, False, False, 0.0, 1, 0.0, 0.0, 0, 0)
    power, frequency = [], []
    steps, peaks, reversals = 0, [], 0
    for motion in motions:
        for start, stop in motion.segments:
            clip, time = motion.u[start:stop, i], motion.time_s[start:stop]
            change = np.diff(clip)
            steps += int((np.abs(change) > 0.15 * span).sum())
            moving = np.sign(change) * (np.abs(change) > 1e-4 * span)
            known = np.flatnonzero(moving)
            turns = known[1:][np.diff(moving[known]) != 0]
            reversals += len(turns)
            peaks += clip[turns].tolist()
            grid = np.arange(time[0], time[-1], motion.dt_s)
            if len(grid) > 8:
                even = np.interp(grid, time, clip - clip.mean())
                power.append(np.abs(np.fft.rfft(even)) ** 2)
                frequency.append(np.fft.rfftfreq(len(grid), motion.dt_s))
    low = high = 0.0
    if power:  # frequencies between which nine tenths of the power lie
        every = np.concatenate(frequency)
        order = np.argsort(every)
        summed = np.cumsum(np.concatenate(power)[order])
        ends = np.searchsorted(summed, np.array([0.05, 0.95]) * summed[-1])
        low, high = (period_s * every[order][ends]).tolist()
    levels = _count_distinct(np.abs(np.array(peaks))[:500, None], np.array([size])) if peaks else 2
    crosses_zero = bool(u.min() < -0.02 * size and u.max() > 0.02 * size)
    small_share = float((np.abs(u) < 0.2 * size).mean())
    return InputMeasures(name, True, crosses_zero, small_share, levels, low, high, steps, reversals)
