"""Correlations of the residual with single signals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.signal import correlate

from lagsplat.diagnose.core.config import RESIDUAL_CORRELATION
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, join_signals
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class ResidualCorrelations:
    """Correlation of each coordinate's residual with each regressor."""

    coordinates: tuple[str, ...]
    regressors: tuple[str, ...]
    score: Float64[np.ndarray, "d k"]
    """Absolute correlation over the bound that chance exceeds once in twenty times; zero where a coordinate
    has no residual or a regressor does not vary."""


def compute_residual_correlations(
    estimates: Sequence[LatentForceEstimate], *, q_names: Sequence[str], u_names: Sequence[str]
) -> ResidualCorrelations:
    """Correlate each coordinate's residual with inputs, their rates, its own position and velocity, and time.

    The correlation of two smooth series scatters far more than that of white ones: its variance is the sum
    over all lags of the product of their autocorrelations over the number of samples.

    Source: Bartlett (1935), doi:10.2307/2342284.
    """
    lengths = [stop - start for estimate in estimates for start, stop in estimate.motion.segments]
    u, time_s, *motion = join_signals(estimates, "u", "time_s", "q", "v", "residual")
    rates = np.concatenate([compute_input_rates(estimate.motion) for estimate in estimates])
    inputs = {name: u[:, j] for j, name in enumerate(u_names)}
    inputs |= {f"d{name}/dt": rates[:, j] for j, name in enumerate(u_names)}
    names: tuple[str, ...] = ()
    rows = []
    for q, v, residual in zip(*(signal.T for signal in motion), strict=True):
        centred = q - q.mean()
        regressors = inputs | {"q": q, "q²": centred**2, "q³": centred**3}
        regressors |= {"v": v, "sign v": np.sign(v), "|v| v": np.abs(v) * v, "t": time_s}
        names = tuple(regressors)
        rows.append([_score_correlation(residual, column, lengths) for column in regressors.values()])
    return ResidualCorrelations(tuple(q_names), names, np.array(rows))


def _score_correlation(residual: np.ndarray, column: np.ndarray, lengths: Sequence[int]) -> float:
    """Absolute correlation of two series of several clips, over the bound that chance seldom exceeds."""
    first, second = (series - series.mean() for series in (residual, column))
    power = np.sqrt((first @ first) * (second @ second))
    # A constant leaves only rounding errors.
    if power <= 1e-12 * len(first) * np.abs(column).max(initial=0.0) * np.abs(residual).max(initial=0.0):
        return 0.0
    clips = zip(*(np.split(series, np.cumsum(lengths)[:-1]) for series in (first, second)), strict=True)
    # autocorrelations at every lag
    spread = sum(float(correlate(a, a) @ correlate(b, b)) / len(a) for a, b in clips)
    bound = RESIDUAL_CORRELATION.correlation_z * np.sqrt(max(spread, np.finfo(float).tiny))
    return float(abs(first @ second) / bound)


def compute_input_rates(motion: Trajectory) -> Float64[np.ndarray, "T n_u"]:
    """Rates of the inputs; they are known, so differencing them adds no noise."""
    # The rate of a constant input would be rounding errors.
    return np.where(np.ptp(motion.u, axis=0) > 0.0, differentiate_clips(motion.u, motion), 0.0)


def differentiate_clips(values: Float64[np.ndarray, "T k"], motion: Trajectory) -> Float64[np.ndarray, "T k"]:
    """Rates of change of columns within each clip of their motion; zero in a clip of one sample."""
    rates = np.zeros_like(values)
    for start, stop in motion.segments:
        if stop - start > 1 and values.shape[1]:
            rates[start:stop] = np.gradient(values[start:stop], motion.time_s[start:stop], axis=0)
    return rates
