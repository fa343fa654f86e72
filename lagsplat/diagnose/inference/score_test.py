"""The score test of effects: the misfit that each would remove, to first order, without a fit."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int64

from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.effects.parameters import HalfNormal
from lagsplat.diagnose.estimation import multiple_shooting as shooting
from lagsplat.diagnose.inference.problem import EstimationProblem


@dataclass(frozen=True)
class ScoreTestResult:
    """The misfit that an effect would remove, ``gain``, and where a fit of it starts."""

    placed: PlacedEffect
    gain: float
    starts: tuple[np.ndarray, ...]  # parameters of the effect to start from, the best first
    base: shooting.ShootingFit  # of the other effects, beside which it was tested
    information: float  # log evidence of an effect as large as its prior's standard deviation [nat]

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.placed.effect.name


def score_test(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    fit: shooting.ShootingFit,
    candidates: Sequence[PlacedEffect],
    windows: Int64[np.ndarray, " V"] | None = None,
) -> list[ScoreTestResult]:
    """The misfit that each candidate would remove beside ``effects``, to first order; the largest first.

    ``fit`` is of ``effects`` on all windows; the test looks at ``windows`` alone, by default at all.

    Source: the score (Lagrange multiplier) test, Rao, 1948, doi:10.1017/S0305004100023987.
    """
    problem, there = select_windows(problem, fit, windows)
    prior = problem.prior(effects)
    linear = shooting.differentiate_predictions(
        problem.predict(effects), there.x, there.starts, problem.data, prior.step
    )
    # a change is a difference of two rollouts, whose errors of integration cancel
    rollout_model = problem.rollout_model
    coarse = replace(problem, rollout_model=replace(rollout_model, steps=-(-rollout_model.steps // 2)))
    scores = []
    for candidate in candidates:
        if not candidate.changes_motion:
            continue
        tried = []
        for x, change in _trial_changes(coarse, effects, there, candidate):
            gain, amount, information = _score_gain(there, linear, prior, change, candidate)
            if len(candidate.effect.amplitudes):
                x[candidate.effect.amplitudes] = amount
            tried.append((gain, x, information))
        tried.sort(key=lambda row: -row[0])
        if tried:
            starts, information = tuple(x for _, x, _ in tried[:3]), max(row[2] for row in tried)
            scores.append(ScoreTestResult(candidate, tried[0][0], starts, fit, information))
    return sorted(scores, key=lambda score: -score.gain)


def select_windows(
    problem: EstimationProblem, fit: shooting.ShootingFit, windows: np.ndarray | None
) -> tuple[EstimationProblem, shooting.ShootingFit]:
    """The problem, and a fit of it, on some of its windows; on all of them for None."""
    if windows is None or len(windows) == len(fit.starts):
        return problem, fit
    part = replace(problem, windows=problem.windows.select(windows))
    return part, fit.select(windows, part.windows.longest)


def _trial_changes(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    fit: shooting.ShootingFit,
    candidate: PlacedEffect,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Each point of the grid of shapes, with amplitudes zero, and its change of the motion (W, M, n).

    The change is the derivative by each of the ``n`` amplitudes; without amplitudes it is the full one.
    """
    parameters, amplitudes = candidate.effect.parameters, candidate.effect.amplitudes
    shapes, n = candidate.effect.shapes, len(amplitudes)
    grid = candidate.grid
    if grid is None:
        grid = tuple(itertools.product(*(parameters[i].grid for i in shapes)))
    step = [0.01 * parameters[i].prior.deviation for i in amplitudes]
    moves = np.diag(step) @ np.eye(len(parameters))[amplitudes]
    points: list[np.ndarray] = []
    sets: list[np.ndarray] = []
    for point in grid:
        points.append(np.zeros(len(parameters)))
        points[-1][shapes] = [
            parameters[i].prior.unknown(value) for i, value in zip(shapes, point, strict=True)
        ]
        sets += [points[-1] + move for move in moves] if n else [points[-1]]
    known = sum(placed.size for placed in effects)
    whole = np.stack([np.concatenate([fit.x[:known], x, fit.x[known:]]) for x in sets])
    starts = np.repeat(fit.starts[None], len(whole), axis=0)
    y = problem.predict((*effects, candidate))(whole, starts)
    y0 = problem.predict(effects)(fit.x[None], fit.starts[None])
    # a diverged trial carries no derivative
    far = 1e3 * problem.rollout_model.model.basis.scale
    change = np.clip(np.where(np.isfinite(y), y - y0, 0.0), -far, far) * problem.data.weight
    if n:
        change /= np.tile(step, len(points))[:, None, None, None]
    change = change.reshape(len(points), max(n, 1), len(fit.starts), -1).transpose(0, 2, 3, 1)
    return list(zip(points, change, strict=True))


def _score_gain(
    fit: shooting.ShootingFit,
    linear: tuple[np.ndarray, np.ndarray, np.ndarray],
    prior: shooting.GaussianPrior,
    change: np.ndarray,
    candidate: PlacedEffect,
) -> tuple[float, np.ndarray, float]:
    """Misfit that the best amount of a change removes, that amount, and the log evidence of a usual amount.

    All other parameters are refitted.
    """
    residual, slopes, start_slopes = linear
    k, amplitudes = slopes.shape[2], [candidate.effect.parameters[i] for i in candidate.effect.amplitudes]
    left = shooting.eliminate_starts(residual, np.concatenate([slopes, change], axis=2), start_slopes)
    gradient = left.right.copy()
    # the penalty counts as well: an effect gains by letting the nuisance parameters return
    gradient[:k] -= (fit.x - prior.mean) / prior.deviation**2
    own = [1.0 / p.prior.deviation**2 for p in amplitudes] or [1.0]
    h = left.curvature + np.diag(np.concatenate([1.0 / prior.deviation**2, own]))
    nuisance_moves = np.linalg.solve(h[:k, :k], np.concatenate([h[:k, k:], gradient[:k, None]], axis=1))
    amount_curvature = h[k:, k:] - h[k:, :k] @ nuisance_moves[:, :-1]
    amount_gradient = gradient[k:] - h[k:, :k] @ nuisance_moves[:, -1]
    amount = np.linalg.lstsq(amount_curvature, amount_gradient, rcond=1e-10)[0]
    if not amplitudes:
        amount = np.clip(amount, 0.0, 1.0)
    for i, p in enumerate(amplitudes):
        if isinstance(p.prior, HalfNormal):
            amount[i] = max(amount[i], 1e-3 * p.prior.deviation)
        amount[i] = np.clip(amount[i], -3.0 * p.prior.deviation, 3.0 * p.prior.deviation)
    # half the misfit of one standard deviation of the prior
    information = 0.5 * float(np.max(np.diag(amount_curvature) / own - 1.0))
    return float(2.0 * amount @ amount_gradient - amount @ amount_curvature @ amount), amount, information
