"""Held-out forecasts: errors of the sim, and of the sim with effects, on windows that were not fitted.

A block is one natural period long. Its initial state is fitted to its first ten samples by the model that
forecasts; no later sample is used.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import HOLDOUT
from lagsplat.diagnose.core.result import Block, Gap, Interval
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation import multiple_shooting as shooting
from lagsplat.diagnose.estimation.dataset import WindowSet
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, limit_squared_deviation
from lagsplat.diagnose.mechanics.model import MechanicalModel


@dataclass(frozen=True)
class Forecast:
    """Forecasts of every block, and the expected variance of their errors if the model is true."""

    y: Float64[np.ndarray, "B L d"]
    expected: Float64[np.ndarray, "B L d"]


def split_windows(problem: EstimationProblem, none: HypothesisFit) -> tuple[EstimationProblem, WindowSet]:
    """Split into the problem on a half of the windows and the other windows, which are held out.

    Windows are dealt out in the order of what the sim alone, ``none``, leaves of them, so that both halves
    see as much of the gap: what acts in a few windows is fitted to some and forecast in others.
    """
    left = shooting.measure_windows(none.fit.residual, problem.windows.length)
    held_out = np.zeros(len(left), dtype=bool)
    held_out[np.argsort(left)[::-1][1::2]] = True
    return replace(problem, windows=problem.windows.select(~held_out)), problem.windows.select(held_out)


def cut_blocks(problem: EstimationProblem, held_out: WindowSet) -> WindowSet:
    """Cut held-out windows into blocks of one natural period, or of a window where windows are shorter.

    Raises:
        ValueError: no window is as long as `HOLDOUT.min_period_share` of a period.
    """
    frames = max(HOLDOUT.min_block_samples, round(problem.period_s / problem.dataset.dt_s) + 1)
    longest = int(held_out.length.max(initial=0))
    if HOLDOUT.min_period_share * frames <= longest < frames:
        frames = longest
    first = [
        start + k * (frames - 1)
        for start, length in zip(held_out.first, held_out.length, strict=True)
        for k in range((length - 1) // (frames - 1))
    ]
    if not first:
        raise ValueError(
            f"no held-out stretch of {frames} samples (one natural period, {problem.period_s:.3g} s) is "
            "left; record longer"
        )
    return WindowSet(np.array(first, dtype=np.int64), np.full(len(first), frames, dtype=np.int64))


def forecast_blocks(
    problem: EstimationProblem, blocks: WindowSet, effects: Sequence[PlacedEffect], x: np.ndarray
) -> Forecast:
    """Forecast ``blocks`` with the parameters ``x`` of ``effects`` and of the nuisance model."""
    moving = [placed for placed in effects if placed.changes_motion]
    problem = replace(problem, windows=blocks)
    roll_out, data, no_parameters = problem.predict(moving), problem.data, np.zeros(0)

    def predict(_: np.ndarray, starts: np.ndarray) -> np.ndarray:
        return roll_out(np.repeat(x[None], len(starts), axis=0), starts)

    seen_so_far = (data.weight > 0.0).any(axis=2).cumsum(axis=1)
    early = data.weight * (seen_so_far <= HOLDOUT.start_samples)[..., None]
    no_prior = shooting.GaussianPrior(*[no_parameters] * 4)
    starts, first = problem.initial_states, replace(data, weight=early)
    fit = shooting.fit_multiple_shooting(
        predict, no_parameters, starts, first, no_prior, iterations=8, tolerance=1e-6
    )
    flat = replace(data, weight=np.ones_like(early))
    residual, _, slopes = shooting.differentiate_predictions(
        predict, no_parameters, fit.starts, flat, no_parameters
    )
    n_blocks, length, d = early.shape
    slopes = slopes.reshape(n_blocks, length * d, -1)
    is_seen = (early.reshape(n_blocks, -1) > 0.0)[..., None]
    variance = np.tile(problem.sigma**2, length)
    weighted = slopes * is_seen / variance[None, :, None]
    gram = np.einsum("bms,bmt->bst", weighted, slopes)
    gram += 1e-9 * np.eye(gram.shape[1]) * np.trace(gram, axis1=1, axis2=2)[:, None, None]
    # a diverged rollout no longer depends on its initial state
    start_covariance = np.linalg.pinv(np.nan_to_num(gram, posinf=0.0, neginf=0.0), hermitian=True)
    spread = np.einsum("bms,bst,bmt->bm", slopes, start_covariance, slopes)
    expected = np.where(is_seen[..., 0], np.maximum(variance - spread, 0.0), variance + spread)
    return Forecast(flat.y - residual, expected.reshape(n_blocks, length, d))


def count_diverged(error: Float64[np.ndarray, "B L d"], rms: Float64[np.ndarray, " d"]) -> int:
    """Number of forecasts whose error exceeds `HOLDOUT.diverged_error` rms somewhere."""
    return int((~(np.abs(error / rms) <= HOLDOUT.diverged_error)).any(axis=(1, 2)).sum())


def estimate_closure(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> Interval:
    """Share of the gap above the noise floor that is closed, with a 95 % bootstrap interval over blocks.

    None where the interval of the gap above the floor holds zero. The arguments are mean squares of
    each block: without effects, with effects, and as expected if the model is true.
    """
    above = bootstrap_blocks(lambda b, f: b - f, before, floor)
    assert above.value is not None
    assert above.low is not None
    if above.value <= 0.0 or above.low <= 0.0:
        return Interval(None, None, None)
    return bootstrap_blocks(lambda b, a, f: (b - a) / np.maximum(b - f, 1e-12), before, after, floor)


def bootstrap_blocks(measure: Callable[..., np.ndarray], *squares: Float64[np.ndarray, " B"]) -> Interval:
    """A measure of root mean squares with its 95 % bootstrap interval over blocks.

    ``squares`` are mean squares of each block; ``measure`` gets their root means, one of each a draw.
    """
    n = len(squares[0])
    draws = np.random.default_rng(0).integers(0, n, (2000, n))
    value = measure(*(np.sqrt(values.mean()) for values in squares))
    drawn = measure(*(np.sqrt(values[draws].mean(axis=1)) for values in squares))
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Interval(float(value), float(low), float(high))


@dataclass(frozen=True)
class HeldOutForecast:
    """Forecasts of one hypothesis, and mean squares of each block in units of the blocks."""

    y: Float64[np.ndarray, "B L d"]
    error: Float64[np.ndarray, "B L d"]
    squares: Float64[np.ndarray, " B"]  # of the errors, at most those of `HOLDOUT.most_error`
    floor: Float64[np.ndarray, " B"]  # expected where nothing is missing: of noise and the sim's own error
    relative_error: float  # root mean square of all errors [rms of each coordinate]
    relative_floor: float  # the same of what is expected where nothing is missing

    @property
    def rms_error(self) -> float:
        """Root mean square of all errors in units of the blocks."""
        return float(np.sqrt(self.squares.mean()))


def fit_half(half: EstimationProblem, hypothesis: HypothesisFit) -> Float64[np.ndarray, " k"]:
    """Parameters of a hypothesis, fitted to the half of the windows that is not held out.

    The sim's own parameters go no further than is plausible: what only an implausible sim explains is not
    explained.
    """
    return keep_plausible(half, hypothesis, half.fit(hypothesis.fitted, hypothesis.fit.x).x)


def keep_plausible(
    half: EstimationProblem, hypothesis: HypothesisFit, x: Float64[np.ndarray, " k"]
) -> Float64[np.ndarray, " k"]:
    """Parameters whose part of the sim's own goes no further from zero than is plausible."""
    x = x.copy()
    own = x[hypothesis.n_effect_parameters :]
    moved = float(np.sum((own / half.rollout_model.nuisance.deviation) ** 2))
    own *= min(1.0, float(np.sqrt(limit_squared_deviation(len(own)) / max(moved, 1e-12))))
    return x


class HeldOutBlocks:
    """The held-out part of a recording, which one hypothesis after another forecasts.

    Errors are in units of each coordinate's rms; of a sim that has an error of its own, in units of that.
    """

    def __init__(self, problem: EstimationProblem, split: tuple[EstimationProblem, WindowSet]) -> None:
        """Cut the windows; ``split`` is what to fit and what to hold out, as `split_windows` returns them.

        Raises:
            ValueError: the held-out part has no stretch of one period.
        """
        self.problem, record = problem, problem.dataset
        self.half, held_out = split
        self.blocks = cut_blocks(problem, held_out)
        self.rms, self.real = np.std(record.q, axis=0), self.blocks.take(record.q)
        # an effect in one coordinate must not drown in what a law misses of the others
        self.unit = problem.deviation if np.any(problem.own_error) else self.rms

    def forecast(self, hypothesis: HypothesisFit) -> HeldOutForecast:
        """Fit a hypothesis to the other half and forecast the blocks."""
        x = fit_half(self.half, hypothesis)
        return self.measure(forecast_blocks(self.problem, self.blocks, hypothesis.effects, x), hypothesis)

    def forecast_given(self, model: MechanicalModel) -> HeldOutForecast:
        """Forecast the blocks with a model as it is."""
        rollout_model = replace(self.problem.rollout_model, model=model)
        problem = replace(self.problem, rollout_model=rollout_model)
        still = np.zeros(rollout_model.nuisance.size)
        return self.measure(forecast_blocks(problem, self.blocks, (), still), None)

    def measure(self, forecast: Forecast, hypothesis: HypothesisFit | None) -> HeldOutForecast:
        """Errors of forecasts; where an effect repeats samples, what repeats an earlier one is explained."""
        error = forecast.y - self.real
        effects = hypothesis.effects if hypothesis else ()
        if any(isinstance(placed.effect, SampleEffect) and placed.effect.repeats for placed in effects):
            error[self.blocks.take(self.problem.repeated_samples)] = 0.0
        expected = forecast.expected + self.problem.own_error

        def average(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            most = HOLDOUT.most_error**2 * float(np.mean((self.rms / unit) ** 2))
            squares, floor = (np.mean(x / unit**2, axis=(1, 2)) for x in (error**2, expected))
            bounded = (np.minimum(np.nan_to_num(x, nan=most, posinf=most), most) for x in (squares, floor))
            return tuple(bounded)

        relative = (float(np.sqrt(x.mean())) for x in average(self.rms))
        return HeldOutForecast(forecast.y, error, *average(self.unit), *relative)


def measure_own_error(problem: EstimationProblem, none: HypothesisFit) -> Float64[np.ndarray, " d"]:
    """Mean square error of the sim's forecasts of its own recordings, beyond the noise [coordinate^2].

    A learned law misses what it was learned from; no effect can take its error below that. A forecast that
    misses by more than the rms of the motion, as one that diverges, counts as one by a sim at rest. Zero
    where the recordings are too short to hold anything out.
    """
    try:
        held_out = HeldOutBlocks(problem, split_windows(problem, none))
    except ValueError:
        return np.zeros(problem.dataset.d)
    x = fit_half(held_out.half, none)
    forecast, most = forecast_blocks(problem, held_out.blocks, (), x), held_out.rms
    errors = (np.nan_to_num(np.abs(forecast.y - held_out.real), nan=np.inf), np.sqrt(forecast.expected))
    square, expected = (np.mean(np.minimum(error, most) ** 2, axis=(0, 1)) for error in errors)
    return np.maximum(square - expected, 0.0)


@dataclass(frozen=True)
class HoldoutForecasts:
    """Errors on the held-out half: the gap, the blocks, and mean squares of each block.

    ``beyond_refit`` is the share of the gap as given that the chosen effects remove beyond what a refit
    alone removes; ``given_over_floor`` and ``refit_over_floor`` are the errors of the sim as given and after
    a refit, over their floors.
    """

    held_out: HeldOutBlocks
    gap: Gap
    blocks: tuple[Block, ...]
    before: np.ndarray
    floor: np.ndarray
    beyond_refit: Interval
    given_over_floor: Interval
    refit_over_floor: Interval

    def estimate_closure(self, hypothesis: HypothesisFit) -> Interval:
        """Closure of another hypothesis on the same blocks."""
        return estimate_closure(self.before, self.held_out.forecast(hypothesis).squares, self.floor)


def forecast_holdout(
    problem: EstimationProblem,
    none: HypothesisFit,
    chosen: HypothesisFit,
    *,
    given: MechanicalModel,
) -> HoldoutForecasts:
    """The held-out error of the sim as ``given``, after a refit alone, and with the ``chosen`` effects.

    ``given`` is the model before any recalibration, ``none`` the fit without effects.

    Raises:
        ValueError: the held-out part has no stretch of one period.
    """
    held_out, record = HeldOutBlocks(problem, split_windows(problem, none)), problem.dataset
    forecasts = {
        "before": held_out.forecast_given(given),
        "refit": held_out.forecast(none),
        "after": held_out.forecast(chosen),
    }
    before, refit, after = (forecast.squares for forecast in forecasts.values())
    floor, rms = forecasts["after"].floor, held_out.rms
    gap = Gap(
        **{name: forecast.relative_error for name, forecast in forecasts.items()},
        floor=forecasts["after"].relative_floor,
        horizon_s=problem.period_s,
        closure=estimate_closure(before, after, floor),
        blocks=len(held_out.real),
        diverged={name: count_diverged(forecast.error, rms) for name, forecast in forecasts.items()},
    )
    rows = []
    for i, (start, length) in enumerate(zip(held_out.blocks.first, held_out.blocks.length, strict=True)):
        number = record.file_of[int(np.searchsorted(record.clips[:, 1], start, side="right"))]
        time_s = record.time[start : start + length] + record.shifts_s[number]
        sim, augmented = (forecasts[name].y[i] for name in ("before", "after"))
        rows.append(Block(record.files[number], i, time_s, held_out.real[i], sim, augmented))
    beyond = bootstrap_blocks(lambda b, r, a: (r - a) / np.maximum(b, r), before, refit, after)
    levels = (
        bootstrap_blocks(lambda error, f: error / f, forecasts[name].squares, forecasts[name].floor)
        for name in ("before", "refit")
    )
    return HoldoutForecasts(held_out, gap, tuple(rows), before, floor, beyond, *levels)
