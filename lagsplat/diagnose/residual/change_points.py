"""When the residual acts: spans of time between change points, under a bounded rate of false discoveries."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress, pairwise

import numpy as np
from jaxtyping import Float64, Int64
from ruptures import KernelCPD
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2, false_discovery_control

from lagsplat.diagnose.core.config import CHANGE_POINTS, RESIDUAL_CORRELATION
from lagsplat.diagnose.residual.latent_force import (
    LatentForceEstimate,
    compute_relative_squares,
    compute_rms_acceleration,
)


@dataclass(frozen=True)
class ResidualEvent:
    """A span of one motion in which the residual is large."""

    motion: int  # number of the motion
    start_s: float  # on the motion's clock [s]
    end_s: float  # on the motion's clock [s]
    share: float  # of all motions' residual inside


def find_events(estimates: Sequence[LatentForceEstimate], *, period_s: float) -> list[ResidualEvent]:
    """Find the spans that hold most of the residual, largest share first, at most `CHANGE_POINTS.max_events`.

    Change points of the residual's level (the logarithm of its square, averaged over half a period) divide
    each clip. A span is kept where the residual differs from zero given its uncertainty, under a false
    discovery rate of `CHANGE_POINTS.false_discovery_rate`, and shrunk to where it acts. Neighbours of similar
    strength are joined.

    Source: Killick, Fearnhead, Eckley (2012) for the change points; Benjamini and Hochberg (1995).
    """
    squares = [energy.sum(axis=1) for energy in compute_relative_squares(estimates)]
    weights = [compute_sample_weights(estimate) for estimate in estimates]
    total = sum(float(weight @ square) for weight, square in zip(weights, squares, strict=True))
    unit = compute_rms_acceleration(estimates)
    spans = [
        (number, start, stop)
        for number, (estimate, square) in enumerate(zip(estimates, squares, strict=True))
        for start, stop in _split_at_changes(estimate, square, unit, period_s)
    ]
    if not spans or total <= 0.0:
        return []
    chances = [_compute_chance(estimates[number], start, stop, period_s) for number, start, stop in spans]
    significant = false_discovery_control(chances) < CHANGE_POINTS.false_discovery_rate
    events = []
    for number, start, stop in compress(spans, significant):
        square, time_s = squares[number], estimates[number].motion.time_s
        limit = CHANGE_POINTS.edge_share**2 * square[start:stop].max()
        first, last = start + np.flatnonzero(square[start:stop] >= limit)[[0, -1]]
        inside = slice(first, last + 1)
        share = float(weights[number][inside] @ square[inside]) / total
        events.append(ResidualEvent(number, float(time_s[first]), float(time_s[last]), share))
    bridged = sorted(_bridge_events(events, period_s), key=lambda event: -event.share)
    large = [event for event in bridged if event.share >= CHANGE_POINTS.min_energy_share]
    return large[: CHANGE_POINTS.max_events]


def compute_sample_weights(estimate: LatentForceEstimate) -> Float64[np.ndarray, " T"]:
    """Time that each sample represents [s]: half a step to either side, inside its clip."""
    half = 0.5 * np.diff(estimate.motion.time_s) * estimate.motion.joined
    return np.append(half, 0.0) + np.append(0.0, half)


def number_blocks(estimates: Sequence[LatentForceEstimate], period_s: float) -> Int64[np.ndarray, " n"]:
    """Number of each sample's block of `RESIDUAL_CORRELATION.block_periods`, which lies within one motion."""
    numbers, first = [], 0
    for estimate in estimates:
        elapsed = np.cumsum(compute_sample_weights(estimate))
        blocks = (elapsed / (RESIDUAL_CORRELATION.block_periods * period_s)).astype(np.int64)
        numbers.append(first + blocks)
        first += int(blocks[-1]) + 1
    return np.concatenate(numbers)


def _split_at_changes(
    estimate: LatentForceEstimate, square: np.ndarray, unit: np.ndarray, period_s: float
) -> list[tuple[int, int]]:
    """Half-open spans between change points, clip by clip; none where no force was kept."""
    if not estimate.active.any():
        return []
    dt_s = estimate.motion.dt_s
    stride = max(1, round(CHANGE_POINTS.stride_periods * period_s / dt_s))
    width = max(1, round(CHANGE_POINTS.window_periods * period_s / dt_s))
    uncertain = np.where(estimate.active, estimate.std / unit, 0.0) ** 2
    floor = np.mean(uncertain.sum(axis=1)) + np.finfo(float).tiny
    spans = []
    for start, stop in estimate.motion.segments:
        level = np.log(uniform_filter1d(square[start:stop], width, mode="nearest") + floor)[::stride]
        ends = [len(level)]
        if len(level) >= 4:
            penalty = 2.0 * CHANGE_POINTS.log_level_variance * np.log(len(level))
            ends = KernelCPD(kernel="linear", min_size=2).fit(level[:, None]).predict(pen=penalty)
        borders = [start, *(min(start + end * stride, stop) for end in ends[:-1]), stop]
        spans += [(a, b) for a, b in pairwise(borders) if b > a]
    return spans


def _compute_chance(estimate: LatentForceEstimate, start: int, stop: int, period_s: float) -> float:
    """Probability of as large a residual between two samples if there were none (an upper bound).

    The ends of a long span share their averaging window with its neighbours, and are left out.
    """
    active, dt_s = estimate.active, estimate.motion.dt_s
    edge = round((0.5 * CHANGE_POINTS.window_periods + CHANGE_POINTS.stride_periods) * period_s / dt_s)
    if stop - start > 4 * edge:
        start, stop = start + edge, stop - edge
    spacing = max(1, round(estimate.length_s / dt_s))
    picked = np.arange(start, stop)[:: min(spacing, stop - start)]
    residual = estimate.residual[np.ix_(picked, active)]
    covariance = estimate.covariance[np.ix_(picked, active, active)]
    distance = np.einsum("ta,ta->", residual, np.linalg.solve(covariance, residual[..., None])[..., 0])
    return float(chi2.sf(distance, residual.size))


def _bridge_events(events: list[ResidualEvent], period_s: float) -> list[ResidualEvent]:
    """Join events, in order of time, that are less than a period apart and equally strong."""
    joined: list[ResidualEvent] = []
    for event in events:
        last = joined[-1] if joined else event
        near = last.motion == event.motion and 0.0 < event.start_s - last.end_s < period_s
        strengths = [span.share / max(span.end_s - span.start_s, 1e-9) for span in (last, event)]
        if near and abs(np.log(strengths[0] / strengths[1])) < CHANGE_POINTS.merge_log_ratio:
            joined[-1] = ResidualEvent(last.motion, last.start_s, event.end_s, last.share + event.share)
        else:
            joined.append(event)
    return joined
