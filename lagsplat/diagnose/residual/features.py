"""What a residual force may be a function of, in the groups by which its cause is sorted.

inertial: the whole force of the sim (a wrong inertia divides it by another number; the measured acceleration
would contain the residual itself). conservative: powers and kinks of position. dissipative: odd functions of
velocity. actuation: the inputs, their rates, bent inputs and what inputs were earlier. exogenous: time, and
sinusoids at lines that no input drives. memory: what positions were earlier.
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
    """Samples of the residual and what may explain it.

    ``picked`` (n,) their numbers among the samples of all motions; ``target`` (n, d); ``weight`` (n, d) one
    over its variance; ``fold`` (n,) the cross-validation fold of each sample's block; and for each coordinate
    and group a matrix (n, k), k possibly zero.
    """

    picked: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    fold: np.ndarray
    groups: tuple[dict[str, np.ndarray], ...]


def compute_features(
    mechanics: Mechanics,
    smoothed: Sequence[LatentForceEstimate],
    *,
    period_s: float,
    lines_hz: Sequence[float] = (),
) -> ResidualFeatures:
    """Features of every coordinate on evenly picked samples; ``lines_hz`` [Hz] are sinusoids to try."""
    q, v, u = (np.concatenate([_get_series(one, name) for one in smoothed]) for name in ("q", "v", "u"))
    residual = np.concatenate([one.residual for one in smoothed])
    time_s = np.concatenate([one.motion.time_s for one in smoothed])
    elapsed = np.concatenate([one.motion.time_s - one.motion.time_s[0] for one in smoothed])
    variance = np.concatenate([one.std for one in smoothed]) ** 2 + (0.05 * np.std(residual, axis=0)) ** 2
    rates = np.concatenate([compute_input_rates(one) for one in smoothed])
    fold = _assign_folds(smoothed, period_s)
    picked = np.arange(0, len(q), max(1, int(np.ceil(len(q) / RESIDUAL_FEATURES.max_samples))))
    lagged = np.concatenate([_compute_lagged_columns(one, period_s) for one in smoothed])
    position = (q - mechanics.rest) / np.std(q, axis=0)
    velocity = v / np.sqrt(np.mean(v**2, axis=0))
    whole = mechanics.force(q, v, u) / compute_rest_inertia(mechanics)
    driven = _scale_columns(u)
    bends = (driven**3, np.abs(driven) * driven, np.tanh(3 * driven))
    earlier = lagged[:, mechanics.d * len(RESIDUAL_FEATURES.lags_periods) :]
    actuated = np.concatenate([driven, _scale_columns(rates), *bends, earlier], axis=1)
    outside = _compute_outside_columns(time_s, elapsed / elapsed.max(), lines_hz)
    groups = []
    for i in range(mechanics.d):
        other = np.arange(mechanics.d) != i
        members = {
            "inertial": np.stack([whole[:, i], position[:, i] * whole[:, i]], axis=1),
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


def compute_input_rates(one: LatentForceEstimate) -> Float64[np.ndarray, "T n_u"]:
    """Rates of the inputs, clip by clip: they are known, so that differencing them adds no noise."""
    rates = np.zeros_like(one.motion.u)
    for start, stop in one.motion.segments:
        if stop - start > 1 and one.motion.n_u:
            rates[start:stop] = np.gradient(one.motion.u[start:stop], one.motion.time_s[start:stop], axis=0)
    # what differencing makes of a constant is rounding
    return np.where(np.ptp(one.motion.u, axis=0) > 0.0, rates, 0.0)


def _get_series(one: LatentForceEstimate, name: str) -> np.ndarray:
    return one.motion.u if name == "u" else getattr(one, name)


def _scale_columns(columns: np.ndarray) -> np.ndarray:
    rms = np.sqrt(np.mean(columns**2, axis=0))
    return columns / np.where(rms > 0.0, rms, 1.0)


def _compute_restoring_columns(position: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 6"]:
    low, high = np.quantile(position, [0.2, 0.8])
    kinks = [np.maximum(position - high, 0.0), np.maximum(low - position, 0.0)]
    return np.stack([np.ones_like(position), position, position**2, position**3, *kinks], axis=1)


def _compute_resisting_columns(
    velocity: Float64[np.ndarray, " n"], position: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 4"]:
    sign = np.tanh(velocity / RESIDUAL_FEATURES.reversal_rate_share)
    return np.stack([velocity, sign, np.abs(velocity) * velocity, np.abs(position) * sign], axis=1)


def _compute_outside_columns(
    time_s: np.ndarray, elapsed: np.ndarray, lines_hz: Sequence[float]
) -> np.ndarray:
    columns = [elapsed]
    for frequency in lines_hz:
        columns += [np.sin(2 * np.pi * frequency * time_s), np.cos(2 * np.pi * frequency * time_s)]
    return np.stack(columns, axis=1)


def _compute_drifting_column(elapsed: np.ndarray, position: np.ndarray) -> Float64[np.ndarray, "n 1"]:
    """A stiffness that changes in time, less the constant one it looks like."""
    changing = elapsed * position
    return (changing - position * (changing @ position) / (position @ position))[:, None]


def _compute_lagged_columns(one: LatentForceEstimate, period_s: float) -> np.ndarray:
    """Positions and inputs some time earlier; before a clip's beginning, those at its beginning."""
    columns = np.concatenate([one.q, one.motion.u], axis=1)
    lagged = np.empty((len(columns), columns.shape[1] * len(RESIDUAL_FEATURES.lags_periods)))
    for start, stop in one.motion.segments:
        time_s = one.motion.time_s[start:stop]
        for i in range(lagged.shape[1]):
            lag = RESIDUAL_FEATURES.lags_periods[i % len(RESIDUAL_FEATURES.lags_periods)] * period_s
            lagged[start:stop, i] = np.interp(
                time_s - lag, time_s, columns[start:stop, i // len(RESIDUAL_FEATURES.lags_periods)]
            )
    return _scale_columns(lagged - lagged.mean(axis=0))


def _assign_folds(smoothed: Sequence[LatentForceEstimate], period_s: float) -> Int64[np.ndarray, " n"]:
    """Fold of each sample: blocks of three quarters of a period, dealt out in turn."""
    elapsed, before = [], 0.0
    for one in smoothed:
        passed = np.cumsum(compute_sample_weights(one))
        elapsed.append(before + passed)
        before += float(passed[-1])
    return (np.concatenate(elapsed) / (RESIDUAL_FEATURES.block_periods * period_s)).astype(
        np.int64
    ) % RESIDUAL_FEATURES.folds
