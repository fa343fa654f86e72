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
from lagsplat.diagnose.estimation import multiple_shooting as shooting
from lagsplat.diagnose.estimation.dataset import WindowSet
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
    return replace(problem, windows=kept), problem.windows.select(number % 2 == 1)


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


def compute_relative_square_error(
    error: Float64[np.ndarray, "B L d"], rms: Float64[np.ndarray, " d"]
) -> np.ndarray:
    """Mean square of each block's error, in fractions of each coordinate's rms, (B,)."""
    return np.mean((error / rms) ** 2, axis=(1, 2))


def count_diverged(error: Float64[np.ndarray, "B L d"], rms: Float64[np.ndarray, " d"]) -> int:
    """Number of forecasts whose error exceeds `HOLDOUT.diverged_error` rms somewhere."""
    return int((~(np.abs(error / rms) <= HOLDOUT.diverged_error)).any(axis=(1, 2)).sum())


def estimate_closure(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> Interval:
    """Share of the gap above the noise floor that is closed, with a 95 % bootstrap interval over blocks.

    None where the gap is less than two standard errors above the floor. The arguments are mean squares of
    each block: without effects, with effects, and as expected if the model is true.
    """
    draws = np.random.default_rng(0).integers(0, len(before), (2000, len(before)))

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
    given: MechanicalModel,
) -> HoldoutForecasts:
    """The held-out error of the sim as ``given``, after a refit alone, and with the ``chosen`` effects.

    ``given`` is the model before any recalibration, ``none`` the fit without effects.

    Raises:
        ValueError: the held-out part has no stretch of one period.
    """
    half, held_out = split_windows(problem)
    blocks, record = cut_blocks(problem, held_out), problem.dataset
    rms, real = np.std(record.q, axis=0), blocks.take(record.q)
    original = replace(problem, rollout_model=replace(problem.rollout_model, model=given))
    sim = forecast_blocks(original, blocks, (), np.zeros(problem.rollout_model.nuisance.size))
    refit = forecast_blocks(problem, blocks, (), fit_half(half, none))
    after = forecast_blocks(problem, blocks, chosen.effects, fit_half(half, chosen))
    errors = {"before": sim.y - real, "refit": refit.y - real, "after": after.y - real}
    if any(isinstance(placed.effect, SampleEffect) and placed.effect.repeats for placed in chosen.effects):
        # what repeats an earlier sample is explained
        errors["after"][blocks.take(problem.repeated_samples)] = 0.0
    squares = {name: compute_relative_square_error(error, rms) for name, error in errors.items()}
    squares["floor"] = np.mean(after.expected / rms**2, axis=(1, 2))
    gap = Gap(
        **{name: float(np.sqrt(np.mean(values))) for name, values in squares.items()},
        horizon_s=problem.period_s,
        closure=estimate_closure(squares["before"], squares["after"], squares["floor"]),
        blocks=len(real),
        diverged={name: count_diverged(error, rms) for name, error in errors.items()},
    )
    rows = []
    for i, (start, length) in enumerate(zip(blocks.first, blocks.length, strict=True)):
        number = record.file_of[int(np.searchsorted(record.clips[:, 1], start, side="right"))]
        time_s = record.time[start : start + length] + record.shifts_s[number]
        rows.append(Block(record.files[number], i, time_s, real[i], sim.y[i], after.y[i]))
    return HoldoutForecasts(gap, tuple(rows), squares["before"], squares["floor"])


def fit_half(half: EstimationProblem, hypothesis: HypothesisFit) -> np.ndarray:
    """Parameters of a hypothesis, fitted to the half of the windows that is not held out."""
    return half.fit(hypothesis.fitted, hypothesis.fit.x).x


def estimate_single_closure(
    problem: EstimationProblem, hypothesis: HypothesisFit, holdout: HoldoutForecasts
) -> Interval:
    """Closure of another hypothesis on the same blocks."""
    half, held_out = split_windows(problem)
    blocks, q = cut_blocks(problem, held_out), problem.dataset.q
    forecast = forecast_blocks(problem, blocks, hypothesis.effects, fit_half(half, hypothesis))
    after = compute_relative_square_error(forecast.y - blocks.take(q), np.std(q, axis=0))
    return estimate_closure(holdout.before, after, holdout.floor)
