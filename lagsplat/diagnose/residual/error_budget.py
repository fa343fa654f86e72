"""The ladder from picture to forecast: how much of a gap each stage adds, over what it could not avoid.

Perception (how well pictures are drawn), chart (how well positions are read), one step, and the rollout over
a horizon. The latter three are fractions of each coordinate's rms; errors of pictures keep their own unit.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from sklearn.covariance import MinCovDet

from lagsplat.diagnose.core.config import ERROR_BUDGET
from lagsplat.diagnose.mechanics.model import Mechanics
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate
from lagsplat.diagnose.solvers.runge_kutta import take_runge_kutta_step


@dataclass(frozen=True)
class ErrorStage:
    """A ``value`` between ``low`` and ``high`` (95 %, over blocks) above its ``floor``, None if unknown."""

    name: str
    value: float
    low: float
    high: float
    floor: float | None


@dataclass(frozen=True)
class PerceptionQuality:
    """``ratio`` of the real pictures' error to the nominal, ``outside`` share of frames beyond the nominal
    cloud of latents; ``suspect`` where either says that later findings stand on bad pictures."""

    ratio: float
    outside: float
    suspect: bool


def assess_perception(
    error_real: Float64[np.ndarray, " T"],
    error_nominal: Float64[np.ndarray, " N"],
    latents_real: Float64[np.ndarray, "T d"],
    latents_nominal: Float64[np.ndarray, "N d"],
) -> PerceptionQuality:
    """Judge pictures and latents by those the sim was learnt from.

    Errors are mean squared ones of each frame, decoded from its own latents. The nominal cloud is robustly
    fitted, and outside lies what is farther than all but 1 in 1000 of it, by its own count.

    Raises:
        ValueError: a nominal error of zero on average, against which nothing has a ratio.
    """
    if not np.mean(error_nominal) > 0.0:
        raise ValueError("the nominal pictures are drawn without any error; give errors of pictures held out")
    ratio = float(np.mean(error_real) / np.mean(error_nominal))
    cloud = MinCovDet(random_state=0).fit(latents_nominal)
    limit = np.quantile(cloud.mahalanobis(latents_nominal), ERROR_BUDGET.outside_quantile)
    outside = float(np.mean(cloud.mahalanobis(latents_real) > limit))
    return PerceptionQuality(
        ratio,
        outside,
        ratio > ERROR_BUDGET.suspect_error_ratio or outside > ERROR_BUDGET.suspect_outside_share,
    )


def compute_perception_stage(
    error_real: Float64[np.ndarray, " T"],
    error_nominal: Float64[np.ndarray, " N"],
    *,
    block: int,
    seed: int = 0,
) -> ErrorStage:
    """Root mean squared error of pictures over blocks of so many frames; the floor is the nominal one's."""
    blocks = [error_real[start : start + block] for start in range(0, len(error_real), block)]
    floor = float(np.sqrt(np.mean(error_nominal)))
    return _bootstrap_stage("perception", [np.mean(one) for one in blocks], floor, seed)


def compute_chart_stage(
    smoothed: Sequence[LatentForceEstimate], nominal: Sequence[LatentForceEstimate] | None, *, seed: int = 0
) -> ErrorStage:
    """Jitter of positions about their smoothed path, clip by clip; the floor is that of the sim's motions."""
    floor = None if nominal is None else float(np.sqrt(np.mean(_compute_jitters(nominal))))
    return _bootstrap_stage("chart", _compute_jitters(smoothed), floor, seed)


def compute_forecast_stage(
    mechanics: Mechanics,
    smoothed: Sequence[LatentForceEstimate],
    *,
    horizon_s: float,
    nominal: Sequence[LatentForceEstimate] | None = None,
    name: str = "rollout",
    seed: int = 0,
) -> ErrorStage:
    """Gap of the sim's forecasts from smoothed states, one after another, each ``horizon_s`` long.

    The floor is the same number on ``nominal`` motions, which the sim should forecast.

    Raises:
        ValueError: no clip lasts a horizon.
    """
    floor = None
    if nominal is not None:
        floor = float(np.sqrt(np.mean(_compute_forecast_errors(mechanics, nominal, horizon_s))))
    return _bootstrap_stage(name, _compute_forecast_errors(mechanics, smoothed, horizon_s), floor, seed)


def compute_one_step_stage(
    mechanics: Mechanics,
    smoothed: Sequence[LatentForceEstimate],
    *,
    nominal: Sequence[LatentForceEstimate] | None = None,
    seed: int = 0,
) -> ErrorStage:
    """Gap one sample ahead, from every tenth smoothed state on."""
    horizon_s = 1.001 * max(one.motion.dt_s for one in smoothed)
    return compute_forecast_stage(
        mechanics, smoothed, horizon_s=horizon_s, nominal=nominal, name="one step", seed=seed
    )


def measure_error_stages(
    mechanics: Mechanics,
    smoothed: Sequence[LatentForceEstimate],
    nominal: Sequence[LatentForceEstimate] | None,
    *,
    horizon_s: float,
    pictures: tuple[Float64[np.ndarray, " T"], Float64[np.ndarray, " N"]] | None = None,
    block: int = 1,
) -> tuple[ErrorStage, ...]:
    """All rungs from the picture on; without ``pictures`` (errors, nominal errors) those from the chart on.

    A forecast that no clip is long enough for is left out.
    """
    rungs = [] if pictures is None else [compute_perception_stage(*pictures, block=block)]
    rungs.append(compute_chart_stage(smoothed, nominal))
    with contextlib.suppress(ValueError):
        rungs.append(compute_one_step_stage(mechanics, smoothed, nominal=nominal))
        rungs.append(compute_forecast_stage(mechanics, smoothed, horizon_s=horizon_s, nominal=nominal))
    return tuple(rungs)


def compute_stage_shares(
    *, decoded: float, smoothed: float, one_step: float, rollout: float
) -> dict[str, tuple[float, float]]:
    """Share of a picture's error that each stage adds, (at least zero, as computed), by telescoping.

    Mean squared errors of pictures decoded from the encoded positions, the smoothed ones, one step and a
    rollout of the sim. As computed, shares sum to one; a negative one is a stage that repaired the last.

    Raises:
        ValueError: a rollout without error.
    """
    if not rollout > 0.0:
        raise ValueError(f"the rollout's error is {rollout}: there is nothing to share out")
    raw = np.array([decoded, smoothed - decoded, one_step - smoothed, rollout - one_step]) / rollout
    names = ("perception", "chart", "one step", "rollout")
    return {name: (max(0.0, float(share)), float(share)) for name, share in zip(names, raw, strict=True)}


def forecast_positions(
    mechanics: Mechanics,
    q: Float64[np.ndarray, "B d"],
    v: Float64[np.ndarray, "B d"],
    time_s: Float64[np.ndarray, "B K"],
    u: Float64[np.ndarray, "B K n_u"],
    *,
    finest_s: float,
) -> Float64[np.ndarray, "B K d"]:
    """Positions at ``time_s`` from states at its first instants, inputs linear between samples.

    Runge-Kutta of fourth order, no step longer than ``finest_s``. All forecasts run side by side. One that
    leaves all bounds stays infinite.
    """
    d = q.shape[1]
    state = np.concatenate([q, v], axis=1)
    path = [q]

    def slope(x: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        return np.concatenate([x[:, d:], mechanics.acceleration(x[:, :d], x[:, d:], inputs)], axis=1)

    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(time_s.shape[1] - 1):
            h = time_s[:, k + 1] - time_s[:, k]
            count = max(1, int(np.ceil(h.max() / finest_s)))
            part = (h / count)[:, None]
            for i in range(count):
                first, middle, last = (
                    u[:, k] + (i + share) / count * (u[:, k + 1] - u[:, k]) for share in (0.0, 0.5, 1.0)
                )
                state = take_runge_kutta_step(slope, state, part, (first, middle, last))
            path.append(state[:, :d])
    return np.nan_to_num(np.stack(path, axis=1), nan=np.inf)


def _compute_forecast_errors(
    mechanics: Mechanics, smoothed: Sequence[LatentForceEstimate], horizon_s: float
) -> list[float]:
    """Mean squared error of each forecast over its coordinate's variance, at most that of
    `ERROR_BUDGET.max_relative_error`."""
    variance = np.var(np.concatenate([one.motion.q for one in smoothed]), axis=0)
    errors: list[float] = []
    for one in smoothed:
        motion = one.motion
        length = max(2, int(np.floor(horizon_s / motion.dt_s + 1e-6)) + 1)
        stride = max(length - 1, 10) if length == 2 else length - 1
        starts = [start for a, b in motion.segments for start in range(a, b - length + 1, stride)]
        if not starts:
            continue
        at = np.array(starts)[:, None] + np.arange(length)
        path = forecast_positions(
            mechanics, one.q[starts], one.v[starts], motion.time_s[at], motion.u[at],
            finest_s=max(ERROR_BUDGET.max_step_share * horizon_s, 0.25 * motion.dt_s),
        )  # fmt: skip
        squares = np.mean((path[:, 1:] - motion.q[at[:, 1:]]) ** 2 / variance, axis=(1, 2))
        errors += np.minimum(squares, ERROR_BUDGET.max_relative_error**2).tolist()
    if not errors:
        raise ValueError(f"no clip lasts {horizon_s:.3g} s, so nothing can be forecast that far; shorten it")
    return errors


def _compute_jitters(smoothed: Sequence[LatentForceEstimate]) -> list[float]:
    variance = np.var(np.concatenate([one.motion.q for one in smoothed]), axis=0)
    return [
        float(np.mean(one.innovation[a:b] ** 2 / variance))
        for one in smoothed
        for a, b in one.motion.segments
    ]


def _bootstrap_stage(name: str, squares: Sequence[float], floor: float | None, seed: int) -> ErrorStage:
    """Root of the mean square with its bootstrap interval over blocks."""
    values = np.asarray(squares, dtype=float)
    drawn = np.random.default_rng(seed).integers(0, len(values), (ERROR_BUDGET.bootstrap_draws, len(values)))
    tail = 0.5 * (1.0 - ERROR_BUDGET.coverage)
    low, high = np.sqrt(np.quantile(values[drawn].mean(axis=1), [tail, 1.0 - tail]))
    return ErrorStage(name, float(np.sqrt(values.mean())), float(low), float(high), floor)
