"""Sampling of a recording: averages of one far finer than its motion, and checks of one too coarse or short.

Computing time grows with every sample, and a thousand of them a period hold no more than a hundred means of
ten.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import find_objects, label

from lagsplat.diagnose.core.config import SAMPLING
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.natural_period import compute_rms_period_s
from lagsplat.diagnose.data_quality.noise import MeasurementNoise, measure_resolution
from lagsplat.io.trajectory.logged_inputs import LoggedInputs, average_groups
from lagsplat.io.trajectory.trajectory import Trajectory

REPEATED_SAMPLES_CHECK = "repeated samples"  # name of the check for samples that repeat the one before


def average_dense_samples(
    motions: Sequence[Trajectory], *, hold: str, kept_fine: Collection[str] = ()
) -> tuple[tuple[Trajectory, ...], tuple[Finding, ...]]:
    """Average neighbours where a period has far more than `SAMPLING.decimated_samples_per_period` samples.

    At least `SAMPLING.decimated_rate_hz` a second remain, and `SAMPLING.fine_rate_hz` in motions whose source
    is among ``kept_fine``. ``hold`` is how inputs act between samples: ``zoh`` or ``linear``. Returns the
    motions and a finding for each that was averaged.
    """
    period_s = compute_rms_period_s(motions, 1)
    averaged, findings = [], []
    for motion in motions:
        ratio = (period_s or 0.0) / (SAMPLING.decimated_samples_per_period * motion.dt_s)
        kept_hz = SAMPLING.fine_rate_hz if motion.source in kept_fine else SAMPLING.decimated_rate_hz
        ratio = min(ratio, 1.0 / (kept_hz * motion.dt_s))
        n = max(int(ratio + 1e-9), 1)
        shorter = average_samples(motion, n, held=hold == "zoh") if n > 1 else motion
        averaged.append(shorter)
        if shorter is not motion:
            what = (
                f"{1.0 / motion.dt_s:.3g} samples a second are far more than the motion needs, so that "
                f"means of {n} are looked at, {1.0 / shorter.dt_s:.3g} a second"
            )
            why = "what happens within so short a time, as a sample that comes late, is not seen"
            remedy = "cut out and give a short stretch, if that is what is sought"
            findings.append(Finding("note", "averaged", motion.source, what, why, remedy))
    return tuple(averaged), tuple(findings)


def average_samples(motion: Trajectory, n: int, *, held: bool) -> Trajectory:
    """Average ``n`` samples at a time, each time within one clip.

    Samples left over at a clip's end are dropped. The result keeps the inputs as they were logged, too. A
    mean of counts is as wrong as a count where the motion stays within one, and better by the square root of
    the counts that it moves through, at most ``n``; so is the resolution that the result names.

    Source: quantisation error of dithered signals, Widrow and Kollar 2008, doi:10.1017/CBO9780511754661.
    """
    groups = [(start, (stop - start) // n) for start, stop in motion.segments if stop - start >= 2 * n]
    if not groups:
        return motion
    kept = motion.pieces([(start, start + n * count) for start, count in groups])
    log = LoggedInputs(kept.time_s, kept.u, kept.segments, n, held)
    resolution = measure_resolution([motion])
    moved = n * np.mean(np.abs(np.diff(motion.q, axis=0)), axis=0)
    counts = np.clip(moved / np.where(resolution > 0.0, resolution, 1.0), 1.0, n)
    return replace(
        motion,
        time_s=np.concatenate([kept.time_s[a:b].reshape(-1, n).mean(axis=1) for a, b in kept.segments]),
        q=average_groups(kept.time_s, kept.q, kept.segments, n),
        v=None if kept.v is None else average_groups(kept.time_s, kept.v, kept.segments, n),
        u=log.average(kept.u),
        segments=tuple(pairwise([0, *np.cumsum([count for _, count in groups]).tolist()])),
        resolution=tuple((resolution / np.sqrt(counts)).tolist()),
        input_log=log,
    )


def count_blocks(motions: Sequence[Trajectory], *, period_s: float) -> int:
    """Count the blocks into which motions can be divided.

    A block lasts `SAMPLING.block_periods` natural periods ``period_s`` [s], or `SAMPLING.block_samples`
    samples if that is longer.
    """
    blocks = 0
    for motion in motions:
        length_s = max(SAMPLING.block_periods * period_s, SAMPLING.block_samples * motion.dt_s)
        for start, stop in motion.segments:
            blocks += int((motion.time_s[stop - 1] - motion.time_s[start] + motion.dt_s) / length_s + 1e-9)
    return blocks


def check_length(
    motions: Sequence[Trajectory], *, period_s: float | None, noise: MeasurementNoise, side: str
) -> list[Finding]:
    """Check that there is motion, and enough of it to fit on one half and to test on the other."""
    q = np.concatenate([motion.q - motion.q.mean(axis=0) for motion in motions])
    size = np.sqrt((q**2).mean(axis=0))
    rounding = 1e-12 * np.abs(np.concatenate([motion.q for motion in motions])).max()
    still = size <= np.maximum(SAMPLING.rest_noise_ratio * noise.known_sigma, rounding)
    still &= ~_moves_smoothly(motions)
    names = tuple(name for name, at_rest in zip(motions[0].q_names, still, strict=True) if at_rest)
    if still.all() or period_s is None:
        what = "nothing swings: no coordinate moves beyond its noise in a way that returns"
        why = "a mechanism at rest shows no law of motion"
        remedy = "record it released from away from its rest, or driven, for some ten swings"
        return [Finding("undetermined", "at rest", side, what, why, remedy, names)]
    findings = []
    if names:
        what = f"{', '.join(names)} does not move beyond its noise"
        why, remedy = "nothing can be said of its dynamics", "record a motion in which it takes part"
        findings.append(Finding("warn", "coordinate at rest", side, what, why, remedy, names))
    duration_s = sum(motion.duration_s for motion in motions)
    periods, blocks = duration_s / period_s, count_blocks(motions, period_s=period_s)
    remedy = f"record at least {SAMPLING.min_blocks * SAMPLING.block_periods * period_s:.3g} s"
    if periods < SAMPLING.min_periods:
        what = f"{duration_s:.3g} s, or {periods:.2g} natural periods of {period_s:.3g} s"
        why = "on so little every cause looks alike"
        findings.append(Finding("undetermined", "too short", side, what, why, remedy))
    elif blocks < SAMPLING.min_blocks:
        what = f"{blocks} block(s) of {SAMPLING.block_periods:g} natural periods ({duration_s:.3g} s in all)"
        half = SAMPLING.min_blocks // 2
        why = f"{half} to fit and {half} to test are wanted, so that less can be told apart"
        remedy += " in clips of several periods"
        findings.append(Finding("warn", "short", side, what, why, remedy))
    return findings


def check_slowness(motions: Sequence[Trajectory], *, period_s: float | None) -> list[Finding]:
    """Report motions so slow that the inertia hardly acts, against the natural period ``period_s`` [s].

    A motion of period T has the inertial force ``(period_s / T)^2``, over the restoring one.
    """
    slow_s, fast_s = (compute_rms_period_s(motions, order) for order in (0, 1))
    if period_s is None or slow_s is None or fast_s is None:
        return []
    share = period_s**2 / (slow_s * fast_s)
    if share > SAMPLING.min_inertial_share:
        return []
    what = f"quasi-static: inertial forces are {100.0 * share:.2g} % of the restoring ones"
    why = "masses, damping and delays hardly show in so slow a motion; friction and stiffness do"
    remedy = f"record motions with periods of about {period_s:.3g} s as well"
    return [Finding("warn", "quasi-static", "real", what, why, remedy)]


def _moves_smoothly(motions: Sequence[Trajectory]) -> np.ndarray:
    """Whether each coordinate, though small, moves smoothly: several samples in a row agree."""
    smooth = np.zeros(motions[0].d, dtype=bool)
    for motion in motions:
        for start, stop in motion.segments:
            part = motion.q[start:stop] - motion.q[start:stop].mean(axis=0)
            if len(part) < 50:
                continue
            power = (part**2).mean(axis=0)
            same = (part[1:] * part[:-1]).mean(axis=0)
            smooth |= (same > 0.5 * power) & (power > 0)
    return smooth


def check_samples(motion: Trajectory, *, period_s: float | None, noise: MeasurementNoise) -> list[Finding]:
    """Check for repeated, rounded and clipped values, few samples in a period, and times not in seconds."""
    findings = [
        *_check_quantisation(motion, noise),
        *_check_clipping(motion, noise),
        *_check_repeats(motion, noise),
    ]
    if period_s is not None and period_s / motion.dt_s < SAMPLING.coarse_samples_per_period:
        density = period_s / motion.dt_s
        level = "undetermined" if density < SAMPLING.min_samples_per_period else "warn"
        what = f"{density:.2g} samples a natural period"
        why = "rates and accelerations are guesswork between so few"
        wanted_hz = 2.0 * SAMPLING.coarse_samples_per_period / period_s
        remedy = f"record at least {wanted_hz:.3g} samples a second"
        findings.append(Finding(level, "too coarse", motion.source, what, why, remedy))
    if motion.dt_s > SAMPLING.slowest_step_s or (period_s or 0.0) > SAMPLING.slowest_period_s:
        swings = "" if period_s is None else f", and a natural period of {period_s:.4g} s"
        what = f"a sample every {motion.dt_s:.4g} s, over {motion.duration_s:.4g} s{swings}"
        why = "times are read in seconds, and hardly a mechanism is so slow"
        remedy = "divide t by 1000 if it is in milliseconds"
        findings.append(Finding("warn", "slow clock", motion.source, what, why, remedy))
    return findings


def _check_quantisation(motion: Trajectory, noise: MeasurementNoise) -> list[Finding]:
    """Findings of coordinates whose quantisation step is large compared with their motion."""
    findings = []
    for name, step, size in zip(motion.q_names, noise.step, motion.q.std(axis=0), strict=True):
        if step > SAMPLING.quantization_share * size:
            what = f"{name} comes in steps of {step:.3g}, {step / max(size, 1e-300):.2g} of its rms"
            why = "small motions vanish in the steps and look like friction"
            remedy = "record larger motions, or with a finer sensor"
            findings.append(Finding("warn", "quantised", motion.source, what, why, remedy, (name,)))
    return findings


def _check_clipping(motion: Trajectory, noise: MeasurementNoise) -> list[Finding]:
    """Findings of coordinates that stay at an extreme value."""
    findings = []
    for i, name in enumerate(motion.q_names):
        values = motion.q[:, i]
        for extreme, which in ((values.max(), "largest"), (values.min(), "smallest")):
            at = values == extreme
            lengths = np.bincount(label(at)[0])[1:]
            count, share = int((lengths >= SAMPLING.clipped_run).sum()), at.mean()
            # A coarse step makes plateaus at every turning point; so does a rest that is the extreme.
            coarse = noise.step[i] >= 0.02 * np.ptp(values)
            if count >= 2 and SAMPLING.clipped_share < share < 0.5 and not coarse:
                what = (
                    f"{name} stays exactly at its {which} value {extreme:.6g} in {100 * share:.2g} % of the "
                    f"samples, {count} times"
                )
                why, remedy = "a sensor at its limit looks like an end stop", "check the sensor's range"
                findings.append(Finding("warn", "clipped", motion.source, what, why, remedy, (name,)))
    return findings


def _check_repeats(motion: Trajectory, noise: MeasurementNoise) -> list[Finding]:
    """Finding of samples that repeat the one before while the motion goes on.

    The motion during a run of equal samples is that of the cubic through the two samples before and the two
    after it: at a turning point, or between two counts of an encoder, it comes to nothing.
    """
    same = (np.diff(motion.q, axis=0) == 0.0).all(axis=1) & motion.joined
    runs = [(run.start, run.stop) for (run,) in find_objects(label(same)[0])]
    spans = np.array(runs, dtype=int).reshape(-1, 2)
    # two other samples of the clip on each side
    joined = np.pad(motion.joined, 2)
    inside = (joined[spans[:, :1] + [0, 1]] & joined[spans[:, 1:] + [2, 3]]).all(axis=1)
    first, last = spans[inside & (np.diff(spans, axis=1)[:, 0] <= SAMPLING.max_repeats)].T
    if not len(first):
        return []
    outside = np.stack([first - 2, first - 1, last + 1, last + 2], axis=1)
    middle_s = 0.5 * (motion.time_s[first] + motion.time_s[last])
    half_s = 0.5 * (motion.time_s[last] - motion.time_s[first])
    offset = (motion.time_s[outside] - middle_s[:, None]) / half_s[:, None]
    ends = np.array([1.0, -1.0])[:, None] ** np.arange(4)
    weights = (ends[0] - ends[1]) @ np.linalg.inv(offset[..., None] ** np.arange(4))
    moved = np.abs(np.einsum("rk,rkd->rd", weights, motion.q[outside]))
    error = np.linalg.norm(weights, axis=1, keepdims=True) * np.maximum(noise.known_sigma, noise.step)
    lost = (moved > SAMPLING.repeat_noise_ratio * error + 1e-9 * np.ptp(motion.q, axis=0)).any(axis=1)
    if not lost.any():
        return []
    what = (
        f"{int((last - first)[lost].sum())} sample(s) repeat the one before while the motion goes on, the "
        f"first at {motion.time_s[first[lost][0] + 1]:.6g} s"
    )
    why = "a sample that is given twice is a sample that was lost"
    remedy = "record without losses; `frame_drops` is among the candidates"
    return [Finding("warn", REPEATED_SAMPLES_CHECK, motion.source, what, why, remedy)]
