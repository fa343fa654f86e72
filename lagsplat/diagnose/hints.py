"""Where to look for disturbances: the spans and the lines of the force that a sim lacks."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from scipy.signal import find_peaks

from lagsplat.diagnose.catalogue import Hints
from lagsplat.diagnose.model import Model
from lagsplat.diagnose.record import clock_shifts
from lagsplat.diagnose.residual_time import events
from lagsplat.diagnose.smoother import Smoothed, smooth
from lagsplat.io.motion import Motion

LINES = 5
HIGHEST = 0.2
"""Highest line, as a share of the rate of frames."""


def hints(smoothed: Sequence[Smoothed], *, period_s: float) -> tuple[Hints, ...]:
    """The loudest spans, on the joint clock, and lines of the longest file, for each coordinate."""
    shifts = clock_shifts([one.motion for one in smoothed])
    pushes = tuple(
        (one.start_s - shifts[one.motion], one.end_s - shifts[one.motion])
        for one in events(smoothed, period_s=period_s)
    )
    longest = max(smoothed, key=lambda one: one.motion.n)
    return tuple(Hints(pushes, lines(longest, i)) for i in range(longest.motion.d))


def sought(model: Model, motions: Sequence[Motion], *, period_s: float, hold: str) -> tuple[Hints, ...]:
    """Hints from the force that the sim lacks; none where it cannot follow the motions at all."""
    try:
        return hints(smooth(model, motions, period_s=period_s, hold=hold), period_s=period_s)
    except np.linalg.LinAlgError:
        return (Hints((), ()),) * model.d


def lines(one: Smoothed, coordinate: int) -> tuple[float, ...]:
    """The frequencies [Hz] of the highest peaks in the spectrum of the residual."""
    motion = one.motion
    time = np.arange(motion.time_s[0], motion.time_s[-1], motion.dt_s)
    x: Float64[np.ndarray, " n"] = np.interp(time, motion.time_s, one.residual[:, coordinate])
    size = 4 * len(x)
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), size))
    frequency = np.fft.rfftfreq(size, motion.dt_s)
    power[frequency > HIGHEST / motion.dt_s] = 0.0
    peaks, found = find_peaks(power[2:], height=0.0)
    best = peaks[np.argsort(found["peak_heights"])[::-1][:LINES]] + 2
    return tuple(float(frequency[i]) for i in best)
