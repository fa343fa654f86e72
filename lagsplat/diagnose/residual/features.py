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

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.diagnose.core.config import RESIDUAL_FEATURES
from lagsplat.diagnose.mechanics.model import Mechanics, compute_rest_inertia
from lagsplat.diagnose.residual.change_points import compute_sample_weights
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate

FEATURE_GROUPS = ("inertial", "conservative", "dissipative", "actuation", "exogenous", "memory")


@dataclass(frozen=True)
class ResidualFeatures:
    """Samples of the residual and the columns that may explain it.

    ``picked`` (n,) are the samples' numbers in all motions together; ``target`` (n, d) the residual;
    ``weight`` (n, d) one over its variance; ``fold`` (n,) the cross-validation fold of each sample's block;
    ``groups`` has for each coordinate a matrix (n, k) by group, k possibly zero.
    """

    picked: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    fold: np.ndarray
    groups: tuple[dict[str, np.ndarray], ...]


def compute_features(
    mechanics: Mechanics,
    estimates: Sequence[LatentForceEstimate],
    *,
    period_s: float,
    lines_hz: Sequence[float] = (),
) -> ResidualFeatures:
    """Compute the features of every coordinate on evenly picked samples.

    Args:
        mechanics: the simulator's equations of motion.
        estimates: the motions and their residuals.
        period_s: the natural period [s].
        lines_hz: frequencies of sinusoids to try [Hz].
    """
    q, v, u = (
        np.concatenate([_get_series(estimate, name) for estimate in estimates]) for name in ("q", "v", "u")
    )
    residual = np.concatenate([estimate.residual for estimate in estimates])
    time_s = np.concatenate([estimate.motion.time_s for estimate in estimates])
    elapsed = np.concatenate([estimate.motion.time_s - estimate.motion.time_s[0] for estimate in estimates])
    variance = (
        np.concatenate([estimate.std for estimate in estimates]) ** 2 + (0.05 * np.std(residual, axis=0)) ** 2
    )
    rates = np.concatenate([compute_input_rates(estimate) for estimate in estimates])
    fold = _assign_folds(estimates, period_s)
    picked = np.arange(0, len(q), max(1, int(np.ceil(len(q) / RESIDUAL_FEATURES.max_samples))))
    lagged = np.concatenate([_compute_lagged_columns(estimate, period_s) for estimate in estimates])
    position = (q - mechanics.rest) / np.std(q, axis=0)
    velocity = v / np.sqrt(np.mean(v**2, axis=0))
    simulated = mechanics.force(q, v, u) / compute_rest_inertia(mechanics)
    inputs = _scale_columns(u)
    bends = (inputs**3, np.abs(inputs) * inputs, np.tanh(3 * inputs))
    earlier = lagged[:, mechanics.d * len(RESIDUAL_FEATURES.lags_periods) :]
    actuated = np.concatenate([inputs, _scale_columns(rates), *bends, earlier], axis=1)
    outside = _compute_outside_columns(time_s, elapsed / elapsed.max(), lines_hz)
    groups = []
    for i in range(mechanics.d):
        other = np.arange(mechanics.d) != i
        members = {
            "inertial": np.stack([simulated[:, i], position[:, i] * simulated[:, i]], axis=1),
            "conservative": np.concatenate(
                [_compute_restoring_columns(position[:, i]), position[:, other]], axis=1
            ),
            "dissipative": np.concatenate(
                [_compute_resisting_columns(velocity[:, i], position[:, i]), velocity[:, other]], axis=1
            ),
            "actuation": actuated,
            "exogenous": np.concatenate([outside, _compute_drifting_column(elapsed, position[:, i])], axis=1),
            "memory": lagged[:, : mechanics.d * len(RESIDUAL_FEATURES.lags_periods)],
        }
        groups.append({name: matrix[picked] for name, matrix in members.items()})
    return ResidualFeatures(
        picked, residual[picked], 1.0 / np.maximum(variance[picked], 1e-300), fold[picked], tuple(groups)
    )


def compute_input_rates(estimate: LatentForceEstimate) -> Float64[np.ndarray, "T n_u"]:
    """Rates (T, n_u) of the inputs, clip by clip; inputs are known, so differencing them adds no noise."""
    rates = np.zeros_like(estimate.motion.u)
    for start, stop in estimate.motion.segments:
        if stop - start > 1 and estimate.motion.n_u:
            rates[start:stop] = np.gradient(
                estimate.motion.u[start:stop], estimate.motion.time_s[start:stop], axis=0
            )
    # The rate of a constant input would be rounding errors.
    return np.where(np.ptp(estimate.motion.u, axis=0) > 0.0, rates, 0.0)


def _get_series(estimate: LatentForceEstimate, name: str) -> np.ndarray:
    return estimate.motion.u if name == "u" else getattr(estimate, name)


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
    sign = np.tanh(velocity / RESIDUAL_FEATURES.reversal_rate_share)
    return np.stack([velocity, sign, np.abs(velocity) * velocity, np.abs(position) * sign], axis=1)


def _compute_outside_columns(
    time_s: np.ndarray, elapsed: np.ndarray, lines_hz: Sequence[float]
) -> np.ndarray:
    """Drift, and a sine and a cosine at each frequency."""
    columns = [elapsed]
    for frequency in lines_hz:
        columns += [np.sin(2 * np.pi * frequency * time_s), np.cos(2 * np.pi * frequency * time_s)]
    return np.stack(columns, axis=1)


def _compute_drifting_column(elapsed: np.ndarray, position: np.ndarray) -> Float64[np.ndarray, "n 1"]:
    """A stiffness that changes in time, without its part along a constant one."""
    changing = elapsed * position
    return (changing - position * (changing @ position) / (position @ position))[:, None]


def _compute_lagged_columns(estimate: LatentForceEstimate, period_s: float) -> np.ndarray:
    """Positions and inputs some time earlier; before a clip begins, those at its beginning."""
    columns = np.concatenate([estimate.q, estimate.motion.u], axis=1)
    lagged = np.empty((len(columns), columns.shape[1] * len(RESIDUAL_FEATURES.lags_periods)))
    for start, stop in estimate.motion.segments:
        time_s = estimate.motion.time_s[start:stop]
        for i in range(lagged.shape[1]):
            lag = RESIDUAL_FEATURES.lags_periods[i % len(RESIDUAL_FEATURES.lags_periods)] * period_s
            lagged[start:stop, i] = np.interp(
                time_s - lag, time_s, columns[start:stop, i // len(RESIDUAL_FEATURES.lags_periods)]
            )
    return _scale_columns(lagged - lagged.mean(axis=0))


def _assign_folds(estimates: Sequence[LatentForceEstimate], period_s: float) -> Int64[np.ndarray, " n"]:
    """Fold of each sample: blocks of `RESIDUAL_FEATURES.block_periods`, assigned to the folds in turn."""
    elapsed, before = [], 0.0
    for estimate in estimates:
        passed = np.cumsum(compute_sample_weights(estimate))
        elapsed.append(before + passed)
        before += float(passed[-1])
    return (np.concatenate(elapsed) / (RESIDUAL_FEATURES.block_periods * period_s)).astype(
        np.int64
    ) % RESIDUAL_FEATURES.folds
