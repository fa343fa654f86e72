"""The natural period of a mechanism from its motion: free or driven, damped, drifting or noisy."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.signal import find_peaks, oaconvolve

from lagsplat.diagnose.core.config import NATURAL_PERIOD
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class _Clip:
    """A clip at even steps of ``dt_s`` [s], centred and scaled."""

    q: Float64[np.ndarray, "N d"]
    u: Float64[np.ndarray, "N n_u"]
    dt_s: float


def estimate_natural_period_s(motions: Sequence[Trajectory]) -> float | None:
    """Estimate the undamped period [s] of the slowest mode; None where nothing swings.

    Only modes that carry `NATURAL_PERIOD.min_mode_share` of the motion count. A linear law ``a = -K q - C v +
    B u + c + e t`` is fitted in the weak form: with test functions that vanish at both ends, derivatives fall
    on them and noise is not differenced. Inputs are part of the law, so that a driven motion yields the
    mechanism's period and not its driver's. Test functions should last about one period: of all lengths
    tried, the one is taken whose period is close to it and has the smallest error. Where no law fits, as when
    a pendulum goes over the top, half-periods between turning points are counted instead. For large
    amplitudes the period is that of an oscillation of the amplitudes in the data.

    Source: weak form, Messenger and Bortz 2021.
    """
    clips = _resample_clips(motions)
    if not clips:
        return None
    longest_s = max(len(clip.q) * clip.dt_s for clip in clips)
    shortest_s = NATURAL_PERIOD.min_test_samples * min(clip.dt_s for clip in clips)
    count = max(2, round(NATURAL_PERIOD.lengths_per_decade * np.log10(longest_s / shortest_s)))
    best_score, best_period_s = -np.inf, None
    for length_s in np.geomspace(shortest_s, longest_s, count):
        period_s, error = _fit_weak_law(clips, length_s)
        if error > NATURAL_PERIOD.max_stiffness_error:
            continue
        # A test function misses a period much longer than itself and averages a much shorter one away.
        score = -np.log(error) - 4.0 * np.log(period_s / length_s) ** 2
        if score > best_score:
            best_score, best_period_s = score, period_s
    return _estimate_turning_period(clips) if best_period_s is None else best_period_s


def _resample_clips(motions: Sequence[Trajectory]) -> list[_Clip]:
    """Clips long enough for a test function, at even steps, in units of the whole motion's deviation."""
    q = np.concatenate([motion.q for motion in motions])
    u = np.concatenate([motion.u for motion in motions])
    if not q.std(axis=0).any():
        return []
    stride = max(1, len(q) // NATURAL_PERIOD.max_samples)
    centre, size = q.mean(axis=0), np.maximum(q.std(axis=0), np.finfo(float).tiny)
    u_centre, u_size = u.mean(axis=0), u.std(axis=0)
    moving = u_size > 1e-9 * (np.abs(u_centre) + u_size)
    shortest = 2 * NATURAL_PERIOD.min_test_samples
    clips = []
    for motion in motions:
        for start, stop in motion.segments:
            if stop - start < shortest:
                continue
            time = motion.time_s[start:stop]
            dt_s = stride * motion.dt_s if stop - start >= shortest * stride else motion.dt_s
            grid = np.arange(time[0], time[-1], dt_s)
            if len(grid) < NATURAL_PERIOD.min_test_samples + 2:
                continue
            position = np.stack([np.interp(grid, time, column) for column in motion.q[start:stop].T], 1)
            inputs = np.zeros((len(grid), 1))
            if moving.any():
                columns = [np.interp(grid, time, column) for column in motion.u[start:stop].T[moving]]
                inputs = (np.stack(columns, 1) - u_centre[moving]) / u_size[moving]
            clips.append(_Clip((position - centre) / size, inputs, dt_s))
    return clips


def _fit_weak_law(clips: Sequence[_Clip], length_s: float) -> tuple[float, float]:
    """Period [s] of the linear law by test functions of ``length_s`` [s], and its stiffness' relative error.

    The error is infinite where there is no such law.
    """
    left, right = [], []
    d = clips[0].q.shape[1]
    for number, clip in enumerate(clips):
        n = round(length_s / clip.dt_s)
        if n < NATURAL_PERIOD.min_test_samples or n > len(clip.q):
            continue
        s = np.linspace(-1.0, 1.0, n)
        half_s = 0.5 * (n - 1) * clip.dt_s
        tests = compute_test_functions(s, half_s)
        columns = np.hstack([clip.q, clip.u])
        inner = [oaconvolve(columns, test[::-1, None], mode="valid", axes=0) for test in tests]
        value, slope, bend = (product[:: max(1, n // 8)] for product in inner)
        trend = np.zeros((len(value), 2 * len(clips)))
        trend[:, 2 * number] = tests[0].sum()
        trend[:, 2 * number + 1] = tests[0].sum() * np.linspace(-1.0, 1.0, len(value))
        weight = 1.0 / tests[0].sum()
        left.append(weight * np.hstack([-value[:, :d], slope[:, :d], value[:, d:], trend]))
        right.append(weight * bend[:, :d])
    if not left:
        return np.nan, np.inf
    rows, target = np.concatenate(left), np.concatenate(right)
    constants = rows[:, 2 * d + clips[0].u.shape[1] :]
    solution, _, rank, _ = np.linalg.lstsq(rows, target, rcond=1e-10)
    unforced = target - constants @ np.linalg.lstsq(constants, target, rcond=1e-10)[0]
    squared_error = ((target - rows @ solution) ** 2).sum(axis=0)
    if squared_error.sum() > (1.0 - NATURAL_PERIOD.min_explained_share) * (unforced**2).sum():
        return np.nan, np.inf
    # Test functions overlap: four neighbours hold about as much information as one.
    freedom = len(rows) / 4.0 - rank
    if freedom < NATURAL_PERIOD.min_surplus:
        return np.nan, np.inf
    variance = (squared_error + 1e-12 * (target**2).sum(axis=0)) / freedom
    return _select_slowest_mode(
        solution[:d].T, np.linalg.pinv(rows.T @ rows, rcond=1e-12)[:d, :d], variance, clips
    )


def compute_test_functions(
    s: Float64[np.ndarray, " n"], half_width_s: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The test function (1 - s^2)^4 and its first two derivatives by time, each (n,).

    ``s`` runs from -1 to 1 over the function's width of twice ``half_width_s`` [s].
    """
    return (
        (1 - s**2) ** 4,
        -8 * s * (1 - s**2) ** 3 / half_width_s,
        (56 * s**2 - 8) * (1 - s**2) ** 2 / half_width_s**2,
    )


def _select_slowest_mode(
    stiffness: np.ndarray, spread: np.ndarray, variance: np.ndarray, clips: Sequence[_Clip]
) -> tuple[float, float]:
    """Period [s] of the slowest mode of ``a = -K q`` that carries enough of the motion.

    With it comes the relative standard error of the mode's stiffness.
    """
    values, shapes = np.linalg.eig(stiffness)
    if np.linalg.cond(shapes) > 1e8:
        return np.nan, np.inf
    q = np.concatenate([clip.q - clip.q.mean(axis=0) for clip in clips])
    rows = np.linalg.inv(shapes)
    carried = (np.abs(q @ rows.T) ** 2).mean(axis=0) * (np.abs(shapes) ** 2).sum(axis=0)
    swings = (values.real > 0) & (np.abs(values.imag) < 0.5 * values.real)
    kept = np.flatnonzero(swings & (carried > NATURAL_PERIOD.min_mode_share * carried.sum()))
    if not kept.size:
        return np.nan, np.inf
    slowest = kept[np.argmin(values.real[kept])]
    shape = shapes[:, slowest]
    error = (np.abs(rows[slowest]) ** 2 @ variance) * (shape.conj() @ spread @ shape)
    square = float(values.real[slowest])
    return 2.0 * np.pi / np.sqrt(square), float(np.sqrt(error.real)) / square


def _estimate_turning_period(clips: Sequence[_Clip]) -> float | None:
    """Twice the median time between turning points, of the coordinate that turns most often."""
    halves_s = []
    for i in range(clips[0].q.shape[1] if clips else 0):
        halves = []
        for clip in clips:
            sides = (clip.q[:, i], -clip.q[:, i])
            turns = [find_peaks(side, prominence=NATURAL_PERIOD.turn_size)[0] for side in sides]
            halves.append(np.diff(np.sort(np.concatenate(turns))) * clip.dt_s)
        halves_s.append(np.concatenate(halves))
    most_turns = max(halves_s, key=len, default=np.zeros(0))
    return 2.0 * float(np.median(most_turns)) if len(most_turns) >= 2 else None


def compute_rms_period_s(motions: Sequence[Trajectory], order: int) -> float | None:
    """Period [s] of the rms frequency of the ``order``-th derivative's spectrum; None where nothing moves."""
    weighted = total = 0.0
    for motion in motions:
        for start, stop in motion.segments:
            x = motion.q[start:stop] - motion.q[start:stop].mean(axis=0)
            if len(x) < NATURAL_PERIOD.min_spectrum_samples or not (x.std(axis=0) > 0.0).all():
                continue
            step = (motion.time_s[stop - 1] - motion.time_s[start]) / (len(x) - 1)
            omega = 2.0 * np.pi * np.fft.rfftfreq(len(x), step)
            power = np.abs(np.fft.rfft(x * np.hanning(len(x))[:, None], axis=0)) ** 2 / x.var(axis=0)
            power_sum = power.sum(axis=1)
            power_sum[0] = 0.0
            power_sum[power_sum < (0.02 if order == 0 else 0.002) * power_sum.max()] = 0.0
            power_sum = power_sum * omega ** (2 * order)
            weighted += float((power_sum * omega**2).sum())
            total += float(power_sum.sum())
    return float(2.0 * np.pi / np.sqrt(weighted / total)) if weighted > 0.0 else None


def estimate_spectral_period_s(motions: Sequence[Trajectory]) -> float:
    """Estimate the period [s] of the motion from the part of its spectrum that is above the noise.

    Where a mechanism goes over the top or is held for long, steps outweigh swings in the spectrum; then the
    spectrum of the rates is used, which weighs both alike.

    Raises:
        ValueError: no clip is long enough, or nothing moves.
    """
    longest = max(stop - start for motion in motions for start, stop in motion.segments)
    if longest < NATURAL_PERIOD.min_spectrum_samples:
        raise ValueError(
            f"{motions[0].source}: the longest clip has {longest} samples, too few to tell how it swings; "
            f"record at least {NATURAL_PERIOD.min_spectrum_samples} without a cut, and better ten periods"
        )
    swing_s, rate_s = compute_rms_period_s(motions, 0), compute_rms_period_s(motions, 1)
    if swing_s is None or rate_s is None:
        raise ValueError(
            f"{motions[0].source}: nothing moves in any clip of "
            f"{NATURAL_PERIOD.min_spectrum_samples} samples; record a motion"
        )
    return rate_s if swing_s > NATURAL_PERIOD.step_period_ratio * rate_s else swing_s
