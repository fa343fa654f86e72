"""Evenly spaced series from frames that are not evenly spaced, for estimators that need them so."""

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline

from lagsplat.chart.clock import Clock


def evenly_spaced(series: Float64[np.ndarray, "N d"], clock: Clock, *, start: int) -> np.ndarray:
    """The series ``dt_s`` apart, (M, d), from the frame ``start`` to its end; itself on an even clock.

    By a cubic spline through the frames at their true times. It has the same span, so that its length may
    differ by some frames.
    """
    if clock.time_s is None:
        return series
    true_s = clock.instants_s(start, len(series))
    even_s = clock.dt_s * np.arange(int(true_s[-1] / clock.dt_s + 1e-6) + 1)
    return CubicSpline(true_s, series)(np.minimum(even_s, true_s[-1]))
