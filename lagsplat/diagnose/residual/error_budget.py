"""The error budget from image to forecast: how much each stage adds to the gap, above an unavoidable floor.

The stages are perception (how well images are decoded), chart (how well positions are measured), one step,
and the rollout over a horizon. The last three are fractions of each coordinate's rms; image errors keep their
own unit.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import ERROR_BUDGET
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate
from lagsplat.diagnose.residual.linearization import integrate_steps


@dataclass(frozen=True)
class ErrorStage:
    """The error of one stage, with its 95 % interval over blocks."""

    name: str
    value: float
    low: float
    high: float
    floor: float | None  # the same error on nominal data; None if there are none


@dataclass(frozen=True)
class PerceptionQuality:
    """How well the real images are read, compared with those that the simulator was fitted to."""

    ratio: float  # of the real images' error to the nominal one
    outside: float  # share of frames beyond the nominal cloud of latents
    suspect: bool  # either is so large that later findings rest on badly read images


def assess_perception(
    error_real: Float64[np.ndarray, " T"],
    error_nominal: Float64[np.ndarray, " N"],
    latents_real: Float64[np.ndarray, "T d"],
    latents_nominal: Float64[np.ndarray, "N d"],
) -> PerceptionQuality:
    """Compare image errors and latents with those of the recording that the simulator was fitted to.

    The errors are mean squares of frames that are decoded from their own latents. The nominal cloud of
    latents is fitted robustly; a frame is outside if it is farther from its middle than all but 1 in 1000 of
    the nominal ones.

    Raises:
        ValueError: a nominal error of zero on average, against which nothing has a ratio.
    """
    from sklearn.covariance import MinCovDet  # a second to import, which only this needs

    if not np.mean(error_nominal) > 0.0:
        raise ValueError("the nominal images are decoded without any error; give errors of held-out images")
    ratio = float(np.mean(error_real) / np.mean(error_nominal))
    cloud = MinCovDet(random_state=0).fit(latents_nominal)
    limit = np.quantile(cloud.mahalanobis(latents_nominal), ERROR_BUDGET.outside_quantile)
    outside = float(np.mean(cloud.mahalanobis(latents_real) > limit))
    suspect = ratio > ERROR_BUDGET.suspect_error_ratio or outside > ERROR_BUDGET.suspect_outside_share
    return PerceptionQuality(ratio, outside, suspect)


def measure_error_stages(
    mechanics: MechanicalModel,
    estimates: Sequence[LatentForceEstimate],
    nominal: Sequence[LatentForceEstimate] | None,
    *,
    horizon_s: float,
    image_errors: tuple[Float64[np.ndarray, " T"], Float64[np.ndarray, " N"]] | None = None,
    block: int = 1,
) -> tuple[ErrorStage, ...]:
    """Compute the stages "perception", "chart", "one step" and "rollout".

    Perception has the images' mean squared error in blocks, and the chart the deviation of measured from
    smoothed positions by clip. Forecasts start from smoothed states, those over one step from every tenth,
    those over the horizon one after another; one for which no clip is long enough is left out.

    Args:
        mechanics, estimates: the simulator and the real motions.
        nominal: motions that the simulator should forecast well, for the floors; None if there are none.
        horizon_s: length of the rollouts [s].
        image_errors: mean squared errors of real and nominal frames; without, the budget starts at the chart.
        block: frames in a block of the image errors.
    """
    stages = []
    if image_errors is not None:
        real, drawn_nominal = image_errors
        blocks = [np.mean(real[start : start + block]) for start in range(0, len(real), block)]
        stages.append(_bootstrap_stage("perception", blocks, drawn_nominal))
    jitters = None if nominal is None else _compute_jitters(nominal)
    stages.append(_bootstrap_stage("chart", _compute_jitters(estimates), jitters))
    step_s = 1.001 * max(estimate.motion.dt_s for estimate in estimates)
    with contextlib.suppress(ValueError):
        for name, length_s in (("one step", step_s), ("rollout", horizon_s)):
            errors = _compute_forecast_errors(mechanics, estimates, length_s)
            floor = None if nominal is None else _compute_forecast_errors(mechanics, nominal, length_s)
            stages.append(_bootstrap_stage(name, errors, floor))
    return tuple(stages)


def forecast_positions(
    mechanics: MechanicalModel,
    q: Float64[np.ndarray, "B d"],
    v: Float64[np.ndarray, "B d"],
    time_s: Float64[np.ndarray, "B K"],
    u: Float64[np.ndarray, "B K n_u"],
    *,
    finest_s: float,
) -> Float64[np.ndarray, "B K d"]:
    """Positions at ``time_s`` of rollouts from states at its first instants; infinite where one diverges.

    Inputs ``u`` are linear between samples; the method is Runge-Kutta of fourth order, in steps of at most
    ``finest_s`` [s].
    """
    d = q.shape[1]
    state = np.concatenate([q, v], axis=1)
    path = [q]
    nothing = np.zeros((len(q), 3, d))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(time_s.shape[1] - 1):
            h = time_s[:, k + 1] - time_s[:, k]
            stages = np.stack([u[:, k], 0.5 * (u[:, k] + u[:, k + 1]), u[:, k + 1]], axis=1)
            count = max(1, int(np.ceil(h.max() / finest_s)))
            state = integrate_steps(mechanics, state, h[:, None], stages, nothing, count)
            path.append(state[:, :d])
    return np.nan_to_num(np.stack(path, axis=1), nan=np.inf)


def _compute_forecast_errors(
    mechanics: MechanicalModel, estimates: Sequence[LatentForceEstimate], horizon_s: float
) -> list[float]:
    """Mean squared error of each forecast over its coordinate's variance, at most that of a diverged one."""
    variance = np.var(np.concatenate([estimate.motion.q for estimate in estimates]), axis=0)
    errors: list[float] = []
    for estimate in estimates:
        motion = estimate.motion
        length = max(2, int(np.floor(horizon_s / motion.dt_s + 1e-6)) + 1)
        stride = max(length - 1, 10) if length == 2 else length - 1
        starts = [start for a, b in motion.segments for start in range(a, b - length + 1, stride)]
        if not starts:
            continue
        at = np.array(starts)[:, None] + np.arange(length)
        finest_s = max(ERROR_BUDGET.max_step_share * horizon_s, 0.25 * motion.dt_s)
        q, v = estimate.q[starts], estimate.v[starts]
        path = forecast_positions(mechanics, q, v, motion.time_s[at], motion.u[at], finest_s=finest_s)
        squares = np.mean((path[:, 1:] - motion.q[at[:, 1:]]) ** 2 / variance, axis=(1, 2))
        errors += np.minimum(squares, ERROR_BUDGET.max_relative_error**2).tolist()
    if not errors:
        raise ValueError(f"no clip lasts {horizon_s:.3g} s, so nothing can be forecast that far")
    return errors


def _compute_jitters(estimates: Sequence[LatentForceEstimate]) -> list[float]:
    """Mean squared deviation of measured from smoothed positions of each clip, over the variance."""
    variance = np.var(np.concatenate([estimate.motion.q for estimate in estimates]), axis=0)
    return [
        float(np.mean(estimate.innovation[a:b] ** 2 / variance))
        for estimate in estimates
        for a, b in estimate.motion.segments
    ]


def _bootstrap_stage(
    name: str, squares: Sequence[float], nominal: Sequence[float] | np.ndarray | None
) -> ErrorStage:
    """Root of the mean of ``squares`` with its bootstrap interval over blocks, and of ``nominal`` squares."""
    values = np.asarray(squares, dtype=float)
    floor = None if nominal is None else float(np.sqrt(np.mean(nominal)))
    shape = (ERROR_BUDGET.bootstrap_draws, len(values))
    resampled = np.random.default_rng(0).integers(0, len(values), shape)
    tail = 0.5 * (1.0 - ERROR_BUDGET.coverage)
    low, high = np.sqrt(np.quantile(values[resampled].mean(axis=1), [tail, 1.0 - tail]))
    return ErrorStage(name, float(np.sqrt(values.mean())), float(low), float(high), floor)
