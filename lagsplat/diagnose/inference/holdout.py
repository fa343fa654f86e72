"""Held-out forecasts: errors of the sim, and of the sim with effects, on windows that were not fitted.

A block is one natural period long. Its initial state is fitted to its first ten samples by the model that
forecasts; no later sample is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import HOLDOUT
from lagsplat.diagnose.core.result import Block, Gap, Interval
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation.dataset import WindowSet
from lagsplat.diagnose.estimation.multiple_shooting import (
    GaussianPrior,
    ShootingData,
    differentiate_predictions,
    fit_multiple_shooting,
)
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from lagsplat.diagnose.mechanics.model import MechanicalModel


@dataclass(frozen=True)
class Forecast:
    """Forecasts of every block, and the expected variance of their errors if the model is true."""

    y: Float64[np.ndarray, "B L d"]
    expected: Float64[np.ndarray, "B L d"]


def split_windows(problem: EstimationProblem) -> tuple[EstimationProblem, WindowSet]:
    """Split into the problem on every other window and the windows in between, which are held out."""
    number = np.arange(len(problem.windows.first))
    kept = problem.windows.select(number % 2 == 0)
    held = problem.windows.select(number % 2 == 1)
    return replace(problem, windows=kept), held


def cut_blocks(problem: EstimationProblem, held: WindowSet, *, period_s: float) -> WindowSet:
    """Cut held-out windows into blocks of one natural period, or of a window where windows are shorter.

    Raises:
        ValueError: no window is as long as `HOLDOUT.min_period_share` of a period.
    """
    frames = max(HOLDOUT.min_block_samples, round(period_s / problem.rollout_model.dataset.dt_s) + 1)
    longest = int(held.length.max(initial=0))
    if HOLDOUT.min_period_share * frames <= longest < frames:
        frames = longest
    first = [
        start + k * (frames - 1)
        for start, length in zip(held.first, held.length, strict=True)
        for k in range((length - 1) // (frames - 1))
    ]
    if not first:
        raise ValueError(
            f"no held-out stretch of {frames} samples (one natural period, {period_s:.3g} s) is left; "
            "record longer"
        )
    return WindowSet(np.array(first, dtype=np.int64), np.full(len(first), frames, dtype=np.int64))


def forecast_blocks(
    problem: EstimationProblem, blocks: WindowSet, effects: Sequence[PlacedEffect], x: np.ndarray
) -> Forecast:
    """Forecast ``blocks`` with the parameters ``x`` of ``effects`` and of the nuisance model."""
    real = [e for e in effects if not isinstance(e.effect, SampleEffect)]
    held_problem = replace(problem, windows=blocks)

    def predict(_: np.ndarray, starts: np.ndarray) -> np.ndarray:
        return held_problem.predict(real)(np.repeat(x[None], len(starts), axis=0), starts)

    seen_so_far = (held_problem.data.weight > 0.0).any(axis=2).cumsum(axis=1)
    early = held_problem.data.weight * (seen_so_far <= HOLDOUT.start_samples)[..., None]
    data = ShootingData(held_problem.data.y, early, held_problem.data.start_step)
    no_prior = GaussianPrior(*(np.zeros(0) for _ in range(4)))
    fit = fit_multiple_shooting(
        predict, np.zeros(0), held_problem.initial_states, data, no_prior, iterations=8, tolerance=1e-6
    )
    flat = replace(data, weight=np.ones_like(early))
    residual, _, slopes = differentiate_predictions(predict, np.zeros(0), fit.starts, flat, np.zeros(0))
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


def compute_relative_square_error(
    error: Float64[np.ndarray, "B L d"], rms: Float64[np.ndarray, " d"]
) -> np.ndarray:
    """Mean square of each block's error, in fractions of each coordinate's rms, (B,)."""
    return np.mean((error / rms) ** 2, axis=(1, 2))


def count_diverged(error: Float64[np.ndarray, "B L d"], rms: Float64[np.ndarray, " d"]) -> int:
    """Number of forecasts whose error exceeds `HOLDOUT.diverged_error` rms somewhere."""
    return int((~(np.abs(error / rms) <= HOLDOUT.diverged_error)).any(axis=(1, 2)).sum())


def estimate_closure(before: np.ndarray, after: np.ndarray, floor: np.ndarray, *, seed: int = 0) -> Interval:
    """Share of the gap above the noise floor that is closed, with a 95 % bootstrap interval over blocks.

    None where the gap is less than two standard errors above the floor.

    Args:
        before: mean square of each block without effects.
        after: mean square of each block with effects.
        floor: expected mean square of each block if the model is true.
        seed: of the bootstrap.
    """
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, len(before), (2000, len(before)))

    def share(rows: np.ndarray) -> np.ndarray:
        b, a, f = (np.sqrt(np.mean(values[rows], axis=-1)) for values in (before, after, floor))
        return (b - a) / np.maximum(b - f, 1e-12)

    above = np.sqrt(before[draws].mean(axis=1)) - np.sqrt(floor[draws].mean(axis=1))
    gap = np.sqrt(before.mean()) - np.sqrt(floor.mean())
    if gap < 2.0 * above.std() or gap <= 0.0:
        return Interval(None, None, None)
    low, high = np.percentile(share(draws), [2.5, 97.5])
    return Interval(float(share(np.arange(len(before)))), float(low), float(high))


@dataclass(frozen=True)
class HoldoutForecasts:
    """Errors on the held-out half: the gap, the blocks, and mean squares of each block."""

    gap: Gap
    blocks: tuple[Block, ...]
    before: np.ndarray
    floor: np.ndarray


def forecast_holdout(
    problem: EstimationProblem,
    none: HypothesisFit,
    chosen: HypothesisFit,
    *,
    period_s: float,
    given: MechanicalModel,
) -> HoldoutForecasts:
    """The held-out error of the sim as given, after a refit alone, and with the ``chosen`` effects.

    Args:
        problem: data, sim and noise.
        none: fit without effects.
        chosen: fit with the chosen effects.
        period_s: length of a block, the longest natural period [s].
        given: the model before any recalibration.

    Raises:
        ValueError: the held-out part has no stretch of one period.
    """
    half, held = split_windows(problem)
    blocks = cut_blocks(problem, held, period_s=period_s)
    record = problem.rollout_model.dataset
    rms = np.std(record.q, axis=0)
    real = blocks.take(record.q)
    n = problem.rollout_model.nuisance.size
    original = replace(problem, rollout_model=replace(problem.rollout_model, model=given))
    sim = forecast_blocks(original, blocks, (), np.zeros(n))
    refit = forecast_blocks(problem, blocks, (), fit_half(half, none))
    after = forecast_blocks(problem, blocks, chosen.effects, fit_half(half, chosen))
    errors = {"before": sim.y - real, "refit": refit.y - real, "after": after.y - real}
    if problem.repeated_samples is not None and any(
        isinstance(e.effect, SampleEffect) and e.effect.repeats for e in chosen.effects
    ):
        errors["after"][blocks.take(problem.repeated_samples)] = (
            0.0  # what repeats an earlier sample is explained
        )
    squares = {name: compute_relative_square_error(error, rms) for name, error in errors.items()}
    squares["floor"] = np.mean(after.expected / rms**2, axis=(1, 2))
    gap = Gap(
        **{name: float(np.sqrt(np.mean(values))) for name, values in squares.items()},
        horizon_s=period_s,
        closure=estimate_closure(squares["before"], squares["after"], squares["floor"]),
        blocks=len(real),
        diverged={name: count_diverged(error, rms) for name, error in errors.items()},
    )
    shown = _result_blocks(problem, blocks, real, sim.y, after.y)
    return HoldoutForecasts(gap, shown, squares["before"], squares["floor"])


def fit_half(half: EstimationProblem, hypothesis: HypothesisFit) -> np.ndarray:
    """Parameters of a hypothesis, fitted to the half of the windows that is not held out."""
    effects = [e for e in hypothesis.effects if not isinstance(e.effect, SampleEffect)]
    return half.fit(effects, hypothesis.fit.x).x


def estimate_single_closure(
    problem: EstimationProblem, hypothesis: HypothesisFit, held: HoldoutForecasts, *, period_s: float
) -> Interval:
    """Closure of another hypothesis on the same blocks."""
    half, windows = split_windows(problem)
    blocks = cut_blocks(problem, windows, period_s=period_s)
    rms = np.std(problem.rollout_model.dataset.q, axis=0)
    forecast = forecast_blocks(problem, blocks, hypothesis.effects, fit_half(half, hypothesis))
    return estimate_closure(
        held.before,
        compute_relative_square_error(forecast.y - blocks.take(problem.rollout_model.dataset.q), rms),
        held.floor,
    )


def _result_blocks(
    problem: EstimationProblem, blocks: WindowSet, real: np.ndarray, sim: np.ndarray, augmented: np.ndarray
) -> tuple[Block, ...]:
    record = problem.rollout_model.dataset
    out = []
    for i, (start, length) in enumerate(zip(blocks.first, blocks.length, strict=True)):
        clip = int(np.searchsorted(record.clips[:, 1], start, side="right"))
        number = record.file_of[clip]
        cut = slice(0, length)
        time = record.time[start : start + length] + record.shifts_s[number]
        out.append(Block(record.files[number], i, time, real[i, cut], sim[i, cut], augmented[i, cut]))
    return tuple(out)
