"""Inputs that repeat themselves: a shift of such an input in time is known up to whole periods only."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from scipy.signal import correlate

from lagsplat.diagnose.core.config import TIME_ALIGNMENT
from lagsplat.diagnose.core.result import Finding
from lagsplat.io.trajectory.trajectory import Trajectory


def estimate_input_period_s(motions: Sequence[Trajectory], channel: int) -> float | None:
    """Estimate the shortest period [s] of an input; None if it does not repeat itself in every motion.

    A period shifts the input onto itself but for `TIME_ALIGNMENT.max_aperiodic_share` of its variance, and at
    least two of them are recorded.

    Source: squared difference function, de Cheveigne and Kawahara 2002, doi:10.1121/1.1458024.
    """
    clips = [clip for motion in motions for clip in motion.clips()]
    periods_s = np.array([_estimate_clip_period_s(clip, channel) for clip in clips], dtype=float)
    longest_s = float(periods_s.max())  # NaN, which is equal to nothing, where a clip does not repeat
    return longest_s if longest_s < (1.0 + TIME_ALIGNMENT.equal_period_error) * periods_s.min() else None


def _estimate_clip_period_s(clip: Trajectory, channel: int) -> float | None:
    if clip.n < TIME_ALIGNMENT.min_input_samples:
        return None
    step_s = max(clip.dt_s, clip.duration_s / TIME_ALIGNMENT.max_input_samples)
    grid = np.arange(clip.time_s[0], clip.time_s[-1], step_s)
    u: Float64[np.ndarray, " n"] = np.interp(grid, clip.time_s, clip.u[:, channel])
    u = u - u.mean()
    if not u.any():
        return None
    n = len(u) // 2  # a shift leaves at least half of the clip to compare
    product = correlate(u, u, method="fft")[len(u) - 1 :][:n]
    square = np.cumsum(u**2)
    both = square[::-1][:n] + square[-1] - np.append(0.0, square)[:n]
    differing = 1.0 - 2.0 * product / np.maximum(both, np.finfo(float).tiny)
    unlike = np.flatnonzero(differing > TIME_ALIGNMENT.unlike)
    if not unlike.size:
        return None
    later = differing[unlike[0] :]
    # a period that is no whole number of steps misses the lowest difference by half a step
    usual = np.mean(np.diff(u) ** 2) / (4.0 * np.mean(u**2))
    alike = np.flatnonzero(later < min(TIME_ALIGNMENT.max_aperiodic_share + usual, TIME_ALIGNMENT.unlike))
    if not alike.size:
        return None
    stop = alike[0] + int(np.argmax(np.append(later[alike[0] :] >= TIME_ALIGNMENT.unlike, True)))
    return float(step_s * (unlike[0] + alike[0] + np.argmin(later[alike[0] : stop])))


def check_periodic_inputs(motions: Sequence[Trajectory]) -> list[Finding]:
    """Report inputs whose shift in time is known up to whole periods only."""
    findings = []
    for channel, name in enumerate(motions[0].u_names):
        period_s = estimate_input_period_s(motions, channel)
        if period_s is not None:
            what = f"{name} repeats itself every {period_s:.4g} s"
            why = "a delay of it, or an offset of its clock, is known up to whole periods only"
            remedy = f"the shift within {0.5 * period_s:.3g} s is given; add a step at an odd time to know it"
            findings.append(Finding("note", "periodic input", "real", what, why, remedy, (name,)))
    return findings


def estimate_common_period_s(motions: Sequence[Trajectory]) -> float | None:
    """Estimate the period [s] after which all moving inputs repeat; None if they do not."""
    moving = [i for i in range(motions[0].n_u) if any(np.ptp(motion.u[:, i]) for motion in motions)]
    periods_s = np.array([estimate_input_period_s(motions, channel) for channel in moving], dtype=float)
    longest_s = float(periods_s.max(initial=0.0))
    ratios = longest_s / periods_s
    whole = np.abs(ratios - np.rint(ratios)) < TIME_ALIGNMENT.equal_period_error * ratios
    return longest_s if whole.all() and moving else None


def wrap_shift(shift_s: float, period_s: float) -> float:
    """The shift [s] within half a period of zero that is the same but for whole periods.

    Example:
        >>> round(wrap_shift(1.9, 2.0), 3)
        -0.1
    """
    return float(shift_s - period_s * np.rint(shift_s / period_s))
