"""From motions to a record that can be shot through: noise, velocities and natural period."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.noise import local_cubic, noise_level
from lagsplat.diagnose.record import Record, join
from lagsplat.io.motion import Motion

QUIET = 1e-3
"""Noise that is assumed at least, in fractions of the rms: less of a motion is not worth explaining."""
LEAST = 16
"""Samples of the shortest clip whose spectrum is taken."""
STEPPED = 1.6
"""Times by which the period of the coordinates exceeds that of their rates where they step."""


@dataclass(frozen=True)
class Prepared:
    """A record with its smoothed coordinates, accelerations and noise."""

    record: Record
    smooth: Float64[np.ndarray, "N d"]
    acceleration: Float64[np.ndarray, "N d"]
    sigma: Float64[np.ndarray, " d"]


def prepare(motions: Sequence[Motion], *, period_s: float) -> Prepared:
    """Noise from a local cubic over a seventh of the period, velocities over more if noise is strong."""
    clips = [np.array(m.segments, dtype=np.int64) for m in motions]
    levels = [
        noise_level(m.time_s, m.q, clip, width_s=0.15 * period_s)
        for m, clip in zip(motions, clips, strict=True)
    ]
    known = np.array([level for level in levels if np.isfinite(level).all()])
    rms = np.std(np.concatenate([m.q for m in motions]), axis=0)
    sigma = np.median(known, axis=0) if len(known) else QUIET * rms
    worst = float(np.max(sigma / np.maximum(rms, 1e-300)))
    width = (0.12 if worst < 0.004 else 0.2 if worst < 0.015 else 0.28) * period_s
    cubics = [local_cubic(m.time_s, m.q, clip, width_s=width) for m, clip in zip(motions, clips, strict=True)]
    return Prepared(
        join(motions, [slope for _, slope, _ in cubics]),
        np.concatenate([smooth for smooth, _, _ in cubics]),
        np.concatenate([bend for _, _, bend in cubics]),
        np.maximum(sigma, QUIET * rms),
    )


def rough_period_s(motions: Sequence[Motion]) -> float:
    """The rms period of the motion's spectrum, from the part of it that stands above noise [s].

    Where a mechanism goes over the top or is held for long, its steps outweigh its swings; there the spectrum
    of its rate is taken, which weighs both alike.

    Raises:
        ValueError: no clip is long enough, or nothing moves.
    """
    longest = max(stop - start for motion in motions for start, stop in motion.segments)
    if longest < LEAST:
        raise ValueError(
            f"{motions[0].source}: the longest clip has {longest} samples, too few to tell how it swings; "
            f"record at least {LEAST} without a cut, and better ten periods"
        )
    swing_s, rate_s = rms_period_s(motions, 0), rms_period_s(motions, 1)
    if swing_s is None or rate_s is None:
        raise ValueError(
            f"{motions[0].source}: nothing moves in any clip of {LEAST} samples; record a motion"
        )
    return rate_s if swing_s > STEPPED * rate_s else swing_s


def rms_period_s(motions: Sequence[Motion], order: int) -> float | None:
    """The rms period of the spectrum of the ``order``-th derivative; None where nothing moves."""
    weighted = total = 0.0
    for motion in motions:
        for start, stop in motion.segments:
            x = motion.q[start:stop] - motion.q[start:stop].mean(axis=0)
            if len(x) < LEAST or not (x.std(axis=0) > 0.0).all():
                continue
            step = (motion.time_s[stop - 1] - motion.time_s[start]) / (len(x) - 1)
            omega = 2.0 * np.pi * np.fft.rfftfreq(len(x), step)
            power = np.abs(np.fft.rfft(x * np.hanning(len(x))[:, None], axis=0)) ** 2 / x.var(axis=0)
            whole = power.sum(axis=1)
            whole[0] = 0.0
            whole[whole < (0.02 if order == 0 else 0.002) * whole.max()] = 0.0
            whole = whole * omega ** (2 * order)
            weighted += float((whole * omega**2).sum())
            total += float(whole.sum())
    return float(2.0 * np.pi / np.sqrt(weighted / total)) if weighted > 0.0 else None
