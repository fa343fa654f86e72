"""What a residual force may be a function of, in the groups by which its cause is sorted.

- inertial: the whole force of the simulator, because a wrong inertia divides it by another number (the
  measured acceleration would contain the residual itself);
- conservative: powers and kinks of position;
- dissipative: odd functions of velocity;
- actuation: the inputs, their rates, non-linear functions of them, and earlier inputs;
- exogenous: time, and sinusoids at spectral lines that no input drives;
- memory: earlier positions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.diagnose.core.config import RESIDUAL_REGRESSION
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.change_points import number_blocks
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, join_signals
from lagsplat.io.trajectory.trajectory import Trajectory

FEATURE_GROUPS = ("inertial", "conservative", "dissipative", "actuation", "exogenous", "memory")


@dataclass(frozen=True)
class ResidualFeatures:
    """Samples of the residual and the columns that may explain it."""

    target: Float64[np.ndarray, "n d"]  # residual
    weight: Float64[np.ndarray, "n d"]  # one over the residual's variance
    fold: Int64[np.ndarray, " n"]  # cross-validation fold of each sample's block
    groups: tuple[dict[str, np.ndarray], ...]  # for each coordinate a matrix (n, k) by group; k may be zero


def compute_features(
    mechanics: MechanicalModel,
    estimates: Sequence[LatentForceEstimate],
    *,
    period_s: float,
    lines_hz: Sequence[float] = (),
) -> ResidualFeatures:
    """Features of every coordinate on evenly picked samples, with sinusoids of ``lines_hz`` [Hz] to try.

    ``period_s`` is the natural period [s].
    """
    q, v, u, time_s, residual, std = join_signals(estimates, "q", "v", "u", "time_s", "residual", "std")
    elapsed = np.concatenate([estimate.motion.time_s - estimate.motion.time_s[0] for estimate in estimates])
    variance = std**2 + (0.05 * np.std(residual, axis=0)) ** 2
    rates = np.concatenate([compute_input_rates(estimate.motion) for estimate in estimates])
    fold = number_blocks(estimates, period_s) % RESIDUAL_REGRESSION.folds
    picked = np.arange(0, len(q), max(1, int(np.ceil(len(q) / RESIDUAL_REGRESSION.max_samples))))
    lagged = np.concatenate([_compute_lagged_columns(estimate, period_s) for estimate in estimates])
    position = (q - mechanics.rest) / np.std(q, axis=0)
    velocity = v / np.sqrt(np.mean(v**2, axis=0))
    simulated = mechanics.force(q, v, u) / mechanics.rest_inertia
    inputs = _scale_columns(u)
    bends = (inputs**3, np.abs(inputs) * inputs, np.tanh(3 * inputs))
    n_lagged = mechanics.d * len(RESIDUAL_REGRESSION.lags_periods)  # the inputs' lags follow the positions'
    actuated = np.concatenate([inputs, _scale_columns(rates), *bends, lagged[:, n_lagged:]], axis=1)
    angles = [2 * np.pi * frequency * time_s for frequency in lines_hz]
    waves = [function(angle) for angle in angles for function in (np.sin, np.cos)]
    outside = np.stack([elapsed / elapsed.max(), *waves], axis=1)
    groups = []
    for i in range(mechanics.d):
        other = np.arange(mechanics.d) != i
        place, rate = position[:, i], velocity[:, i]
        members = {
            "inertial": [np.stack([simulated[:, i], place * simulated[:, i]], axis=1)],
            "conservative": [_compute_restoring_columns(place), position[:, other]],
            "dissipative": [_compute_resisting_columns(rate, place), velocity[:, other]],
            "actuation": [actuated],
            "exogenous": [outside, _compute_drifting_column(elapsed, place)],
            "memory": [lagged[:, :n_lagged]],
        }
        groups.append({name: np.concatenate(parts, axis=1)[picked] for name, parts in members.items()})
    weight = 1.0 / np.maximum(variance[picked], 1e-300)
    return ResidualFeatures(residual[picked], weight, fold[picked], tuple(groups))


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


def _scale_columns(columns: np.ndarray) -> np.ndarray:
    """Divide each column by its rms."""
    rms = np.sqrt(np.mean(columns**2, axis=0))
    return columns / np.where(rms > 0.0, rms, 1.0)


def _compute_restoring_columns(position: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 6"]:
    """Powers of a position, and springs that act only beyond its outer fifths."""
    low, high = np.quantile(position, [0.2, 0.8])
    kinks = [np.maximum(position - high, 0.0), np.maximum(low - position, 0.0)]
    return np.stack([np.ones_like(position), position, position**2, position**3, *kinks], axis=1)


def _compute_resisting_columns(
    velocity: Float64[np.ndarray, " n"], position: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 4"]:
    """Viscous, Coulomb, quadratic and load-dependent friction for forces of unit size."""
    sign = np.tanh(velocity / RESIDUAL_REGRESSION.reversal_rate_share)
    return np.stack([velocity, sign, np.abs(velocity) * velocity, np.abs(position) * sign], axis=1)


def _compute_drifting_column(elapsed: np.ndarray, position: np.ndarray) -> Float64[np.ndarray, "n 1"]:
    """A stiffness that changes in time, without its part along a constant one."""
    changing = elapsed * position
    return (changing - position * (changing @ position) / (position @ position))[:, None]


def _compute_lagged_columns(estimate: LatentForceEstimate, period_s: float) -> np.ndarray:
    """Positions and inputs some time earlier; before a clip begins, those at its beginning."""
    columns = np.concatenate([estimate.q, estimate.motion.u], axis=1)
    lags_s = [share * period_s for share in RESIDUAL_REGRESSION.lags_periods]
    lagged = np.empty((len(columns), columns.shape[1] * len(lags_s)))
    for start, stop in estimate.motion.segments:
        time_s = estimate.motion.time_s[start:stop]
        for i, (column, lag_s) in enumerate(product(columns[start:stop].T, lags_s)):
            lagged[start:stop, i] = np.interp(time_s - lag_s, time_s, column)
    return _scale_columns(lagged - lagged.mean(axis=0))
