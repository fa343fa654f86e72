"""The score test: the misfit that each effect would remove, to first order and without fitting it."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.effects.parameters import HalfNormal
from lagsplat.diagnose.estimation.multiple_shooting import (
    GaussianPrior,
    ShootingFit,
    differentiate_predictions,
    eliminate_starts,
)
from lagsplat.diagnose.inference.problem import EstimationProblem


@dataclass(frozen=True)
class ScoreTestResult:
    """The misfit that an effect would remove, ``gain``, and where a fit of it starts."""

    placed: PlacedEffect
    gain: float
    starts: tuple[np.ndarray, ...]  # parameters of the effect to start from, the best first


def score_test(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    fit: ShootingFit,
    candidates: Sequence[PlacedEffect],
) -> list[ScoreTestResult]:
    """The misfit that each candidate would remove beside ``effects``, to first order; the largest first.

    Source: the score (Lagrange multiplier) test, Rao, 1948, doi:10.1017/S0305004100023987.
    """
    prior = problem.prior(effects)
    residual, derivatives, start_derivatives = differentiate_predictions(
        problem.predict(effects), fit.x, fit.starts, problem.data, prior.step
    )
    scores = []
    for candidate in candidates:
        if isinstance(candidate.effect, SampleEffect):
            continue
        guesses, columns = _trial_changes(problem, effects, fit, candidate)
        tried = []
        for guess, group in zip(guesses, columns, strict=True):
            gain, amount = _score_gain(fit, residual, derivatives, start_derivatives, prior, group, candidate)
            x = guess.copy()
            n = candidate.effect.amplitudes
            if n:
                x[:n] = amount
            tried.append((gain, x))
        tried.sort(key=lambda row: -row[0])
        if tried:
            scores.append(ScoreTestResult(candidate, tried[0][0], tuple(x for _, x in tried[:3])))
    return sorted(scores, key=lambda score: -score.gain)


def _trial_changes(
    problem: EstimationProblem, effects: tuple[PlacedEffect, ...], fit: ShootingFit, candidate: PlacedEffect
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Parameters on the grid of shapes, and the change of the motion by their amplitudes, (W, M,
    amplitudes)."""
    effect = candidate.effect
    shapes = [p.grid for p in effect.parameters[effect.amplitudes :]]
    grid = list(itertools.product(*shapes)) if candidate.grid is None else list(candidate.grid)
    n = effect.amplitudes
    guesses = [
        np.array([0.0] * n + [p.prior.unknown(g) for p, g in zip(effect.parameters[n:], point, strict=True)])
        for point in grid
    ]
    step = [0.01 * p.prior.deviation for p in effect.parameters[:n]]
    sets = []
    for guess in guesses:
        for i in range(max(n, 1)):
            x = guess.copy()
            if n:
                x[i] += step[i]
            sets.append(x)
    known = sum(len(e.effect.parameters) for e in effects)
    whole = np.stack([np.concatenate([fit.x[:known], x, fit.x[known:]]) for x in sets])
    starts = np.repeat(fit.starts[None], len(whole), axis=0)
    y = problem.predict((*effects, candidate))(whole, starts)
    y0 = problem.predict(effects)(fit.x[None], fit.starts[None])
    # a diverged trial carries no derivative
    far = 1e3 * problem.rollout_model.model.basis.scale
    change = np.clip(np.where(np.isfinite(y), y - y0, 0.0), -far, far) * problem.data.weight
    if n:
        change /= np.tile(step, len(guesses))[:, None, None, None]
    each = max(n, 1)
    flat = change.reshape(len(guesses), each, len(fit.starts), -1).transpose(0, 2, 3, 1)
    return guesses, list(flat)


def _score_gain(
    fit: ShootingFit,
    residual: np.ndarray,
    derivatives: np.ndarray,
    start_derivatives: np.ndarray,
    prior: GaussianPrior,
    group: np.ndarray,
    candidate: PlacedEffect,
) -> tuple[float, np.ndarray]:
    """Misfit that the best amount of a change removes, and that amount, with all other parameters
    refitted."""
    k = derivatives.shape[2]
    all_derivatives = np.concatenate([derivatives, group], axis=2)
    curvature, gradient, *_ = eliminate_starts(residual, all_derivatives, start_derivatives)
    # the penalty counts as well: an effect gains by letting the nuisance parameters return
    gradient[:k] -= (fit.x - prior.mean) / prior.deviation**2
    n = candidate.effect.amplitudes
    inverse = np.concatenate(
        [
            1.0 / prior.deviation**2,
            [1.0 / p.prior.deviation**2 for p in candidate.effect.parameters[:n]] or [1.0],
        ]
    )
    h = curvature + np.diag(inverse)
    nuisance_moves = np.linalg.solve(h[:k, :k], np.concatenate([h[:k, k:], gradient[:k, None]], axis=1))
    amount_curvature = h[k:, k:] - h[k:, :k] @ nuisance_moves[:, :-1]
    amount_gradient = gradient[k:] - h[k:, :k] @ nuisance_moves[:, -1]
    amount = np.linalg.lstsq(amount_curvature, amount_gradient, rcond=1e-10)[0]
    if n == 0:
        amount = np.clip(amount, 0.0, 1.0)
    for i, p in enumerate(candidate.effect.parameters[:n]):
        if isinstance(p.prior, HalfNormal):
            amount[i] = max(amount[i], 1e-3 * p.prior.deviation)
        amount[i] = np.clip(amount[i], -3.0 * p.prior.deviation, 3.0 * p.prior.deviation)
    return float(2.0 * amount @ amount_gradient - amount @ amount_curvature @ amount), amount
