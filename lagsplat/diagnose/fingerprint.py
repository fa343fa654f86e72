"""What the residual force goes with: its correlation with whatever may drive it, over what chance reaches.

The correlation of two series that are both smooth scatters far more than that of white ones: its variance is
the sum over all lags of the product of their autocorrelations (Bartlett 1935, doi:10.2307/2342284), over the
number of samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.signal import correlate

from lagsplat.diagnose.residual_features import input_rates
from lagsplat.diagnose.smoother import Smoothed

BOUND = 1.96
"""Standard deviations that chance exceeds once in twenty times."""


@dataclass(frozen=True)
class Fingerprint:
    """Correlation of each coordinate's residual with its regressors: ``score`` (d, k) is its size over the
    5 % bound, zero where a coordinate has no residual or a regressor does not vary."""

    coordinates: tuple[str, ...]
    regressors: tuple[str, ...]
    score: Float64[np.ndarray, "d k"]


def fingerprint(
    smoothed: Sequence[Smoothed], *, q_names: Sequence[str], u_names: Sequence[str]
) -> Fingerprint:
    """Test the residual of ``smoothed`` motions against inputs, their rates, and functions of its own
    coordinate and velocity, and time."""
    lengths = [stop - start for one in smoothed for start, stop in one.motion.segments]
    residual = np.concatenate([one.residual for one in smoothed])
    q, v = (np.concatenate([getattr(one, name) for one in smoothed]) for name in ("q", "v"))
    inputs = _driving(smoothed, u_names)
    time_s = np.concatenate([one.motion.time_s for one in smoothed])
    names: tuple[str, ...] = ()
    rows = []
    for i in range(q.shape[1]):
        named = inputs | _own(q[:, i], v[:, i]) | {"t": time_s}
        names = tuple(named)
        rows.append([_over_bound(residual[:, i], column, lengths) for column in named.values()])
    return Fingerprint(tuple(q_names), names, np.array(rows))


def _driving(smoothed: Sequence[Smoothed], u_names: Sequence[str]) -> dict[str, np.ndarray]:
    u = np.concatenate([one.motion.u for one in smoothed])
    rates = np.concatenate([input_rates(one) for one in smoothed])
    out = {name: u[:, j] for j, name in enumerate(u_names)}
    return out | {f"d{name}/dt": rates[:, j] for j, name in enumerate(u_names)}


def _own(q: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
    middle = q - q.mean()
    return {"q": q, "q²": middle**2, "q³": middle**3, "v": v, "sign v": np.sign(v), "|v| v": np.abs(v) * v}


def _over_bound(residual: np.ndarray, column: np.ndarray, lengths: Sequence[int]) -> float:
    """Size of the correlation of two series of several clips over `BOUND` of its standard deviations."""
    first, second = (series - series.mean() for series in (residual, column))
    power = np.sqrt((first @ first) * (second @ second))
    # a constant leaves only what rounding makes of it
    if power <= 1e-12 * len(first) * np.abs(column).max(initial=0.0) * np.abs(residual).max(initial=0.0):
        return 0.0
    parts = zip(*(np.split(series, np.cumsum(lengths)[:-1]) for series in (first, second)), strict=True)
    spread = sum(float(_alike(a) @ _alike(b)) for a, b in parts)
    return float(abs(first @ second) / (BOUND * np.sqrt(max(spread, np.finfo(float).tiny))))


def _alike(series: np.ndarray) -> np.ndarray:
    """Sum of products of a series (n,) with itself at every lag (2 n - 1,), over the root of its length."""
    return correlate(series, series, method="fft") / np.sqrt(len(series))
