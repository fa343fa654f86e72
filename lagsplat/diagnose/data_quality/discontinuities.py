"""Places where a motion must not be continued: gaps in time, undeclared cuts, holds by hand, repeated frames.

Throughout, ``sigma`` (d,) is the noise of the coordinates, zero where it is not known, and ``period_s`` the
natural period [s].
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.polynomial import Polynomial
from scipy.ndimage import find_objects, label

from lagsplat.diagnose.core.config import DISCONTINUITIES, REPEATED_FRAMES
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.noise import fit_over_time
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class _Jump:
    """A mismatch of position across the border before sample ``at``, in units of the coordinate."""

    at: int
    coordinate: int
    size: float  # positive
    error: float  # standard error of the size
    rate: float  # a sample, along the jump
    rate_change: float  # mismatch of the rates
    span: float  # range of the motion around


def cut_gaps(motion: Trajectory, *, period_s: float | None) -> tuple[Trajectory, tuple[Finding, ...]]:
    """Cut the motion where samples are missing for longer than it, or its inputs, can be interpolated."""
    step = np.diff(motion.time_s)
    shortest_s = DISCONTINUITIES.min_gap_steps * motion.dt_s
    limit = max(shortest_s, DISCONTINUITIES.min_gap_periods * (period_s or 0.0))
    torn = 1 + np.flatnonzero(motion.joined & (step > limit) | _find_unknown_inputs(motion))
    if not torn.size:
        return motion, ()
    where = [f"{step[k - 1]:.3g} s after {motion.time_s[k - 1]:.6g} s" for k in torn[:4]]
    more = ", ..." if len(torn) > 4 else ""
    what = f"{len(torn)} gap(s) longer than {limit:.3g} s or with a bent input ({', '.join(where)}{more})"
    why, remedy = "what acted in between is not known", "it is cut there and nothing is continued across"
    cut = motion.cut(torn.tolist())
    long = [(a, b) for a, b in cut.segments if b - a >= DISCONTINUITIES.polynomial_samples]
    finding = Finding("warn", "gap", motion.source, what, why, remedy)
    return cut.pieces(long) if long else cut, (finding,)


def _find_unknown_inputs(motion: Trajectory) -> Bool[np.ndarray, " n-1"]:
    """Steps with missing samples across which an input bends, so that its course in between is not known.

    A straight line through the samples beside a gap misses a smooth input in the middle by a quarter of what
    an extrapolation from either side misses at the other, and one that steps by more.
    """
    step, joined = np.diff(motion.time_s), motion.joined
    bend = np.abs(np.diff(np.diff(motion.u, axis=0) / step[:, None], axis=0))
    bend = np.pad(bend * (joined[1:] & joined[:-1])[:, None], ((1, 1), (0, 0)))
    miss = np.maximum(bend[:-1], bend[1:]) * step[:, None]
    bent = (miss > 4.0 * DISCONTINUITIES.max_input_error * np.std(motion.u, axis=0)).any(axis=1)
    return joined & (step > DISCONTINUITIES.missing_steps * motion.dt_s) & bent


def cut_jumps(
    motion: Trajectory, *, sigma: np.ndarray, period_s: float | None
) -> tuple[Trajectory, tuple[Finding, ...]]:
    """Cut the motion where position jumps by more than velocity and noise allow.

    Polynomials through the samples on either side of each border are compared in the middle. A knock, an end
    stop or a push changes only the rate, and is no cut. Where a jump goes along with the motion by a few
    frames' worth and the rate stays, or follows a standstill, frames are missing; this is reported, not cut.
    Jumps more frequent than `DISCONTINUITIES.max_cuts_per_period` are reported and not cut, because then they
    belong to the motion.
    """
    jumps = _find_jumps(motion, sigma, period_s)
    if not jumps:
        return motion, ()
    speed = np.array([np.std(np.diff(motion.q[:, i])) / motion.dt_s for i in range(motion.d)])
    repeated = find_repeated_samples(motion.q, np.array(motion.segments), sigma)
    catch_ups = np.flatnonzero(repeated[:-1] & ~repeated[1:]) + 1
    lost = [
        jump
        for jump in jumps
        if np.abs(catch_ups - jump.at).min(initial=2) < 2
        or _is_frame_loss(jump, motion, float(speed[jump.coordinate]), period_s)
    ]
    cuts = sorted({jump.at for jump in jumps if jump not in lost})
    if len(lost) > len(cuts):  # some losses are too long or too slow to be recognised singly
        lost, cuts = jumps, []
    findings = []
    if lost:
        first_s = motion.time_s[min(jump.at for jump in lost)]
        what = f"{len(lost)} jump(s) along the motion, the first at {first_s:.6g} s"
        why = "samples are missing there although the times go on evenly"
        remedy = "it is not cut, and `frame_drops` is among the candidates"
        findings.append(Finding("warn", "missing samples", motion.source, what, why, remedy))
    most = np.inf if period_s is None else DISCONTINUITIES.max_cuts_per_period * motion.duration_s / period_s
    if len(cuts) > max(3.0, most):
        what = f"{len(cuts)} jumps in position, more than one in two periods"
        why = "so many are no cuts: the sensor jumps, or the motion is sampled too coarsely"
        remedy = "nothing is cut; look at the recording"
        findings.append(Finding("warn", "frequent jumps", motion.source, what, why, remedy))
        cuts = []
    if not cuts:
        return motion, tuple(findings)
    where = ", ".join(f"{motion.time_s[k]:.6g} s" for k in cuts[:5])
    what = f"{len(cuts)} jump(s) that no velocity explains, at {where}{', ...' if len(cuts) > 5 else ''}"
    why = "to continue across them would invent memory"
    remedy = "it is cut there; declare cuts in a column `segment`"
    findings.append(Finding("warn", "undeclared cut", motion.source, what, why, remedy))
    return motion.cut(cuts), tuple(findings)


def drop_holds(
    motion: Trajectory, *, sigma: np.ndarray, period_s: float | None
) -> tuple[Trajectory, tuple[Finding, ...]]:
    """Drop spans in which the motion is held away from its middle and then released.

    Inputs must be constant, because an input that moves is reason enough to start. A clip that rests in the
    middle of its later swing is no hold, nor is one that never moves again.
    """
    if period_s is None or np.ptp(motion.u, axis=0).any():
        return motion, ()
    kept, dropped = [], []
    for start, stop in motion.segments:
        holds = _find_holds(motion, start, stop, sigma, period_s)
        edges = [start, *(edge for hold in holds for edge in hold), stop]
        between = zip(edges[::2], edges[1::2], strict=True)
        kept += [(a, b) for a, b in between if b - a >= DISCONTINUITIES.polynomial_samples]
        dropped += holds
    if not dropped or not kept:
        return motion, ()
    where = ", ".join(f"{motion.time_s[a]:.4g} to {motion.time_s[b - 1]:.4g} s" for a, b in dropped[:4])
    what = f"held still away from the middle of its swing, then let go ({where})"
    why = "a hand that holds is a force that is not recorded"
    remedy = "these stretches are left out and the motion is cut there"
    return motion.pieces(kept), (Finding("warn", "hold", motion.source, what, why, remedy),)


def _find_jumps(motion: Trajectory, sigma: np.ndarray, period_s: float | None) -> list[_Jump]:
    """Find the largest significant mismatch of each neighbourhood, the most visible coordinate first."""
    side = DISCONTINUITIES.polynomial_samples
    if period_s is not None:
        side = int(np.clip(DISCONTINUITIES.polynomial_periods * period_s / motion.dt_s, 4, side))
    degree = 2 if side >= 5 else 1
    jumps: list[_Jump] = []
    for start, stop in motion.segments:
        if stop - start < 2 * side + 2:
            continue
        at = np.arange(start + side, stop - side + 1)
        window = at[:, None] + np.arange(-side, side)
        middle = 0.5 * (motion.time_s[at] + motion.time_s[at - 1])
        offset = (motion.time_s[window] - middle[:, None]) / motion.dt_s
        powers = offset[..., None] ** np.arange(degree + 1)
        ends = [np.linalg.pinv(half)[:, :2] for half in (powers[:, :side], powers[:, side:])]
        noise = np.sqrt(sum((end[:, 0] ** 2).sum(axis=1) for end in ends))
        for i in range(motion.d):
            values = motion.q[window, i]
            left = np.einsum("nck,nk->nc", ends[0], values[:, :side])
            right = np.einsum("nck,nk->nc", ends[1], values[:, side:])
            size, change = (right - left).T
            error = noise * max(sigma[i], 1e-12 * np.ptp(values))
            usual, span = _describe_surroundings(np.abs(size), motion.q[at, i], side)
            limits = (
                DISCONTINUITIES.jump_standard_errors * error,
                DISCONTINUITIES.mismatch_ratio * usual,
                DISCONTINUITIES.min_range_share * span,
                DISCONTINUITIES.knock_ratio * np.abs(change),
            )
            rate = 0.5 * (left[:, 1] + right[:, 1])
            before, step, after = (np.diff(values[:, side - 2 : side + 2]) * np.sign(size)[:, None]).T
            sudden = step - np.maximum(before, after) > DISCONTINUITIES.isolated_step_share * np.abs(size)
            beyond = sudden * np.abs(size) / np.maximum(np.max(limits, axis=0), np.finfo(float).tiny)
            numbers = np.stack([np.abs(size), error, rate * np.sign(size), np.abs(change), span], axis=1)
            jumps += [_Jump(int(at[k]), i, *numbers[k].tolist()) for k in _find_peaks(beyond, side)]
    # One event shows in several coordinates: keep the one in which it is largest.
    kept: list[_Jump] = []
    for jump in sorted(jumps, key=lambda jump: -jump.size / max(jump.span, np.finfo(float).tiny)):
        if all(abs(jump.at - other.at) > side for other in kept):
            kept.append(jump)
    return kept


def _describe_surroundings(size: np.ndarray, q: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Usual mismatch around each border and range of the motion there, without the border's own samples."""
    reach = DISCONTINUITIES.neighborhood_lengths * side
    index = np.concatenate([np.arange(-reach, -side), np.arange(side + 1, reach + 1)])
    index = np.clip(np.arange(len(size))[:, None] + index, 0, len(size) - 1)
    return np.quantile(size[index], DISCONTINUITIES.mismatch_quantile, axis=1), np.ptp(q[index], axis=1)


def _find_peaks(score: np.ndarray, distance: int) -> list[int]:
    """Samples with scores above 1 that no other within ``distance`` exceeds, the largest first."""
    peaks: list[int] = []
    for k in np.argsort(-score):
        if score[k] <= 1.0:
            break
        if all(abs(k - other) > distance for other in peaks):
            peaks.append(int(k))
    return peaks


def _is_frame_loss(jump: _Jump, motion: Trajectory, speed: float, period_s: float | None) -> bool:
    """Whether lost frames explain a jump: whole steps along a motion whose rate continues."""
    frames = jump.size / jump.rate if jump.rate else np.inf
    angle = 2.0 * np.pi * motion.dt_s / period_s if period_s is not None else 0.0
    usual = max(speed * motion.dt_s, 0.5 * jump.span * angle)
    allowed = (DISCONTINUITIES.rate_mismatch_ratio + 1.5 * angle * frames) * usual + jump.error
    return 0.5 < frames < DISCONTINUITIES.max_lost_frames and jump.rate_change < allowed


def _find_holds(
    motion: Trajectory, start: int, stop: int, sigma: np.ndarray, period_s: float
) -> list[tuple[int, int]]:
    """Spans of a clip in which the motion is held still away from its middle, as (first sample, end)."""
    shortest = int(DISCONTINUITIES.min_hold_periods * period_s / motion.dt_s)
    least = max(shortest, 2 * DISCONTINUITIES.polynomial_samples)
    if stop - start < 2 * least:
        return []
    clip = motion.pieces([(start, stop)])
    half = min(DISCONTINUITIES.polynomial_samples, least // 4)
    fit = fit_over_time(clip, width_s=2 * half * motion.dt_s)
    typical = clip.q.std(axis=0)
    still_rate = np.maximum(4.0 * sigma * fit.rate_gain[:, None], 0.02 * typical * 2.0 * np.pi / period_s)
    holds = []
    for (still,) in find_objects(label((np.abs(fit.v) < still_rate).all(axis=1))[0]):
        after = clip.q[still.stop : still.stop + int(2.0 * period_s / motion.dt_s)]
        if still.stop - still.start < least or len(after) < least:
            continue
        swing = 0.5 * np.ptp(after, axis=0)
        position = fit.q[still]
        away = np.abs(np.median(position, axis=0) - 0.5 * (after.max(axis=0) + after.min(axis=0)))
        held = swing > np.maximum(DISCONTINUITIES.min_swing_noise_ratio * sigma, 0.1 * typical)
        held &= away > DISCONTINUITIES.min_hold_offset * swing
        held &= np.ptp(position, axis=0) < DISCONTINUITIES.max_hold_motion * swing
        if held.any():
            holds.append((start + still.start, start + still.stop))
    return holds


def find_repeated_samples(
    q: Float64[np.ndarray, "N d"], clips: Int64[np.ndarray, "C 2"], sigma: Float64[np.ndarray, " d"]
) -> Bool[np.ndarray, " N"]:
    """Mark the samples that repeat an earlier one because a frame was recorded twice.

    A mechanism that sticks moves on from where it stood; a repeated frame is followed by a jump to where the
    motion has arrived by then. ``clips`` are (first sample, end).
    """
    repeated = np.zeros(len(q), dtype=bool)
    step = np.sqrt(2.0) * np.maximum(sigma, 1e-300)
    for start, stop in clips:
        z = q[start:stop] / step
        candidates = _find_repeats_before_jumps(z)
        certain = [span for span in candidates if _misses_smooth_path(z, *span)]
        # Samples beside a repeat may be repeats, too, and a motion that turns catches up without a jump.
        many = len(certain) >= REPEATED_FRAMES.min_certain_repeats
        for first, end in [*candidates, *_find_standstills(z)] if many else certain:
            repeated[start + first + 1 : start + end] = True
    return repeated


def _find_repeats_before_jumps(z: np.ndarray) -> list[tuple[int, int]]:
    """First sample of each standstill that ends in a jump, and the first sample after it."""
    moved = np.abs(np.diff(z, axis=0)).max(axis=1)
    repeats = []
    jumps = (moved[1:] > REPEATED_FRAMES.jump_steps) & (moved[:-1] <= REPEATED_FRAMES.same_image_steps)
    for jump in (np.flatnonzero(jumps) + 2).tolist():
        back = max(0, jump - REPEATED_FRAMES.max_repeats)
        stays = (np.abs(z[back:jump] - z[jump - 1]) <= REPEATED_FRAMES.same_image_steps).all(axis=1)
        first = back if stays.all() else back + int(np.flatnonzero(~stays)[-1]) + 1
        if jump - first >= 2:
            repeats.append((first, jump))
    return repeats


def _find_standstills(z: np.ndarray) -> list[tuple[int, int]]:
    """Spans (first sample, end) that stay within noise of their first sample."""
    standstills, first = [], 0
    while first < len(z):
        away = np.abs(z[first : first + REPEATED_FRAMES.max_repeats] - z[first])
        stays = (away <= REPEATED_FRAMES.same_image_steps).all(axis=1)
        end = first + (len(stays) if stays.all() else int(np.argmin(stays)))
        if end - first >= REPEATED_FRAMES.min_uncertain_length:
            standstills.append((first, end))
        first = end
    return standstills


def _misses_smooth_path(z: np.ndarray, first: int, jump: int) -> bool:
    """Whether a smooth path through the motion before and after misses the standstill from ``first`` on."""
    if first + 1 < REPEATED_FRAMES.neighbor_samples or jump + REPEATED_FRAMES.neighbor_samples > len(z):
        return False
    i = int(np.argmax(np.abs(z[jump] - z[jump - 1])))
    side = REPEATED_FRAMES.neighbor_samples
    beside = np.r_[first + 1 - side : first + 1, jump : jump + side]
    path = Polynomial.fit(beside, z[beside, i], REPEATED_FRAMES.polynomial_degree)
    inside = np.arange(first + 1, jump)
    miss = float(np.abs(z[inside, i] - path(inside)).max())
    misfit = float(np.sqrt(np.mean((z[beside, i] - path(beside)) ** 2)))
    curvature = float(np.abs(path.deriv(2)(np.arange(first, jump + 1))).max())
    lag = REPEATED_FRAMES.curvature_lag
    usual = np.abs(z[2 * lag :, i] - 2.0 * z[lag:-lag, i] + z[: -2 * lag, i]) / lag**2
    allowed = REPEATED_FRAMES.curvature_margin * float(np.quantile(usual, REPEATED_FRAMES.curvature_quantile))
    return (
        miss > REPEATED_FRAMES.significant_miss
        and misfit < max(1.0, REPEATED_FRAMES.neighbor_misfit_share * miss)
        and curvature < allowed
    )
