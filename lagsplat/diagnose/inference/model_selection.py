"""Rank single effects: a score test of all, full fits of the best, and the evidence of each fit."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import label, mean

from lagsplat.diagnose.core.config import SELECTION, DiagnoseConfig
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.effects.parameters import HalfNormal
from lagsplat.diagnose.estimation import multiple_shooting as shooting
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, compute_log_evidence


@dataclass(frozen=True)
class ScoreTestResult:
    """The misfit that an effect would remove, ``gain``, and where a fit of it starts."""

    placed: PlacedEffect
    gain: float
    starts: tuple[np.ndarray, ...]  # parameters of the effect to start from, the best first


def score_test(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    fit: shooting.ShootingFit,
    candidates: Sequence[PlacedEffect],
) -> list[ScoreTestResult]:
    """The misfit that each candidate would remove beside ``effects``, to first order; the largest first.

    Source: the score (Lagrange multiplier) test, Rao, 1948, doi:10.1017/S0305004100023987.
    """
    prior = problem.prior(effects)
    linear = shooting.differentiate_predictions(
        problem.predict(effects), fit.x, fit.starts, problem.data, prior.step
    )
    scores = []
    for candidate in candidates:
        if not candidate.changes_motion:
            continue
        n, tried = candidate.effect.amplitudes, []
        for x, change in _trial_changes(problem, effects, fit, candidate):
            gain, amount = _score_gain(fit, linear, prior, change, candidate)
            if n:
                x[:n] = amount
            tried.append((gain, x))
        tried.sort(key=lambda row: -row[0])
        if tried:
            scores.append(ScoreTestResult(candidate, tried[0][0], tuple(x for _, x in tried[:3])))
    return sorted(scores, key=lambda score: -score.gain)


def _trial_changes(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    fit: shooting.ShootingFit,
    candidate: PlacedEffect,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Each point of the grid of shapes, with amplitudes zero, and its change of the motion (W, M, n).

    The change is the derivative by each of the ``n`` amplitudes; without amplitudes it is the full one.
    """
    n, parameters = candidate.effect.amplitudes, candidate.effect.parameters
    grid = candidate.grid
    if grid is None:
        grid = tuple(itertools.product(*(p.grid for p in parameters[n:])))
    step = [0.01 * p.prior.deviation for p in parameters[:n]]
    points, sets = [], []
    for point in grid:
        shape = [p.prior.unknown(value) for p, value in zip(parameters[n:], point, strict=True)]
        points.append(np.array([0.0] * n + shape))
        for i in range(max(n, 1)):
            x = points[-1].copy()
            if n:
                x[i] += step[i]
            sets.append(x)
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
) -> tuple[float, np.ndarray]:
    """Misfit that the best amount of a change removes, and that amount, all other parameters refitted."""
    residual, slopes, start_slopes = linear
    k, amplitudes = slopes.shape[2], candidate.effect.parameters[: candidate.effect.amplitudes]
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
    return float(2.0 * amount @ amount_gradient - amount @ amount_curvature @ amount), amount


@dataclass(frozen=True)
class SearchBudget:
    """How many hypotheses are fitted in full, and what their evidence is measured against."""

    config: DiagnoseConfig
    nominal: float  # mean square residual of the sim on its own recordings [noise variances]
    log_evidence_offset: float = 0.0
    """Log evidence that effects gain by the sim's own errors [nat]; it is subtracted."""
    correlation: float = 0.0
    """Samples that count as one in the residual of the best explanation, where that leaves much [1]."""
    continued: int | None = None  # best fits that are continued after a trial [count], None for all
    refined: int = SELECTION.refined_fits  # best fits that are refined to convergence [count]

    @property
    def effective_sample_ratio(self) -> float:
        """Samples of a residual that count as one independent sample, at least [1]."""
        return max(self.config.effective_sample_ratio, self.correlation)


@dataclass(frozen=True)
class ModelRanking:
    """`none` and every fitted hypothesis, by falling log evidence."""

    none: HypothesisFit
    found: tuple[HypothesisFit, ...]
    noise_inflation: float  # factor on the variance of the noise [1] at which the best hypothesis fits

    def best_fit(self, name: str) -> HypothesisFit | None:
        """The fit of one effect with the largest evidence, over all places."""
        return next((hypothesis for hypothesis in self.found if hypothesis.name == name), None)


def rank_hypotheses(
    problem: EstimationProblem,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    *,
    known: HypothesisFit | None = None,
    report_progress: Callable[[str], None] = lambda name: None,
) -> ModelRanking:
    """Rank the candidates, each added to the ``known`` effects.

    Two score tests choose what is fitted: one with the nuisance parameters fitted to the gap, one with them
    at zero. The first cannot see an effect that the nuisance parameters imitate.
    """
    n = problem.rollout_model.nuisance.size
    base = known or refine_fit(problem, HypothesisFit((), problem.fit((), np.zeros(n))))
    beginnings = [base.fit]
    if known is None:
        unmoved = problem.with_nuisance(problem.rollout_model.nuisance.freeze()).fit((), np.zeros(n))
        if unmoved.misfit > SELECTION.unmoved_misfit_ratio * base.fit.misfit:
            beginnings.append(replace(unmoved, x=np.zeros(n)))
    config, orders = budget.config, []
    by_family: dict[str, list[tuple[ScoreTestResult, shooting.ShootingFit]]] = {}
    for fit in beginnings:
        scores = score_test(problem, base.effects, fit, candidates)
        order = list(dict.fromkeys(score.placed.effect.name for score in scores))
        orders.append(order[: config.families])
        for score in scores:
            family = by_family.setdefault(score.placed.effect.name, [])
            is_new = all(previous.placed is not score.placed for previous, _ in family)
            if is_new and len(family) < 2 * count_places(score.placed, config):
                family.append((score, fit))
    names = [name for row in zip(*orders, strict=False) for name in row]
    names += [name for order in orders for name in order]
    names += [name for name in config.always_fitted if name in by_family]
    found = []
    for name in dict.fromkeys(names):
        report_progress(name)
        family = sorted(by_family[name], key=lambda pair: -pair[0].gain)
        for score, fit in family[: count_places(family[0][0].placed, config)]:
            found.append(try_candidate(problem, base.effects, fit, score, starts=config.starts))
    return finish_fits(problem, base, found, candidates, budget)


def count_places(placed: PlacedEffect, config: DiagnoseConfig) -> int:
    """Places at which an effect is fitted: as many for each of its variants."""
    return config.places * len(placed.effect.variants)


def finish_fits(
    problem: EstimationProblem,
    base: HypothesisFit,
    found: Sequence[HypothesisFit],
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
) -> ModelRanking:
    """Continue briefly fitted hypotheses, refine the best of them, and rank all."""
    for finish, n in ((continue_fit, budget.continued), (refine_fit, budget.refined)):
        found = sorted(found, key=lambda hypothesis: hypothesis.fit.cost)
        found[:n] = [finish(problem, hypothesis) for hypothesis in found[:n]]
    return rank_by_evidence(problem, base, found, candidates, budget)


def refine_fit(problem: EstimationProblem, hypothesis: HypothesisFit) -> HypothesisFit:
    """Continue a fit to convergence, with more iterations and a smaller tolerance than the first pass."""
    longer = replace(
        problem,
        iterations=SELECTION.refined_iterations * problem.iterations,
        tolerance=SELECTION.refined_tolerance * problem.tolerance,
    )
    if hypothesis.effects:
        return continue_fit(longer, hypothesis)
    return replace(hypothesis, fit=longer.fit((), hypothesis.fit.x, hypothesis.fit.starts))


def rank_by_evidence(
    problem: EstimationProblem,
    base: HypothesisFit,
    found: Sequence[HypothesisFit],
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
) -> ModelRanking:
    """Rank fits by their log evidence over the base, the fit without the new effects.

    The noise of all is inflated until the best fit agrees with it. Beside a base without effects, those
    ``candidates`` that act on single samples are judged as well, by its residual, and the evidence that
    effects gain by the sim's own errors is subtracted.
    """
    ratio = budget.effective_sample_ratio
    noisy = [] if base.effects else _explain_by_sample_noise(problem, base, candidates)
    offset = 0.0 if base.effects else budget.log_evidence_offset
    explained = max(noisy, key=lambda row: row[0], default=(0.0, base))[1].fit.misfit
    least = min([*(hypothesis.fit.misfit for hypothesis in found), base.fit.misfit, explained])
    noise_inflation = max(budget.nominal, least / problem.degrees_of_freedom) * ratio
    floor = compute_log_evidence(base, problem.rollout_model, noise_inflation) + offset
    rows = []
    for hypothesis in found:
        log_evidence = compute_log_evidence(hypothesis, problem.rollout_model, noise_inflation) - floor
        rows.append(replace(hypothesis, log_evidence=log_evidence))
    for gain, hypothesis in noisy:
        log_evidence = gain / ratio - SELECTION.sample_noise_penalty - budget.log_evidence_offset
        rows.append(replace(hypothesis, log_evidence=log_evidence))
    rows.sort(key=lambda hypothesis: -hypothesis.log_evidence)
    return ModelRanking(replace(base, log_evidence=0.0), tuple(rows), noise_inflation)


def _repeated_sample_misfit(problem: EstimationProblem, base: HypothesisFit) -> tuple[float, int]:
    """Squared error of samples that repeat an earlier one, above the noise, and how many are visible."""
    predicted = problem.predict(base.effects)(base.fit.x[None], base.fit.starts[None])[0]
    wrong = np.nan_to_num(((problem.data.y - predicted) / problem.sigma) ** 2).mean(axis=2)
    runs, n = label(problem.repeats, structure=[[0, 0, 0], [1, 1, 1], [0, 0, 0]])
    number = np.arange(1, n + 1)
    seen = runs * np.isin(runs, number[mean(wrong, runs, number) > SELECTION.visible_repeat_misfit])
    missed = (wrong - 1.0)[problem.repeats].sum() * problem.data.y.shape[2]
    return float(missed), int(np.count_nonzero(seen))


def _explain_by_sample_noise(
    problem: EstimationProblem, base: HypothesisFit, candidates: Sequence[PlacedEffect]
) -> list[tuple[float, HypothesisFit]]:
    """Gain of log likelihood by each effect on single samples, from the residual of the base."""
    out = []
    mask = problem.data.weight[..., 0] > 0.0  # a frame shows all coordinates or none
    record, residual = problem.dataset, base.fit.residual
    seen = np.where(mask[..., None], residual, 0.0)
    # from one sample to the next; noise of single samples has none
    correlation = float((seen[:, 1:] * seen[:, :-1]).sum() / max((seen**2).sum(), np.finfo(float).tiny))
    credit = min(max(0.0, 1.0 - correlation / SELECTION.max_noise_correlation), 1.0)
    speed = problem.windows.take(record.v) / problem.sigma * record.dt_s
    for candidate in candidates:
        if not isinstance(candidate.effect, SampleEffect):
            continue
        gain, parameters, misfit = candidate.effect.explain(residual[mask], speed[mask])
        gain *= credit
        if candidate.effect.repeats:
            missed, n = _repeated_sample_misfit(problem, base)
            gain += 0.5 * missed
            parameters = {key: tuple(value + n for value in row) for key, row in parameters.items()}
        fit = replace(base.fit, misfit=misfit)
        out.append((gain, HypothesisFit((*base.effects, candidate), fit, noise=parameters)))
    return out


def _scale_start(
    problem: EstimationProblem, effects: tuple[PlacedEffect, ...], base: shooting.ShootingFit, x: np.ndarray
) -> np.ndarray:
    """Parameters to start from: the share of the score test's amplitude that full rollouts fit best.

    ``x`` (k,) are the parameters of the last effect, ``base`` is the fit of those before it.
    """
    known, n = sum(placed.size for placed in effects[:-1]), effects[-1].effect.amplitudes
    if not n:
        return np.concatenate([base.x[:known], x, base.x[known:]])
    tried = np.repeat(x[None], len(SELECTION.start_shares), axis=0)
    tried[:, :n] *= np.array(SELECTION.start_shares)[:, None]
    whole = np.stack([np.concatenate([base.x[:known], row, base.x[known:]]) for row in tried])
    y = problem.predict(effects)(whole, np.repeat(base.starts[None], len(whole), axis=0))
    misfit = np.sum(((problem.data.y - y) * problem.data.weight) ** 2, axis=(1, 2, 3))
    return whole[int(np.argmin(np.where(np.isfinite(misfit), misfit, np.inf)))]


def try_candidate(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    base: shooting.ShootingFit,
    score: ScoreTestResult,
    *,
    starts: int,
) -> HypothesisFit:
    """A few steps of a fit of one candidate beside ``effects``, from each of its best starting points; the
    best of these fits.
    """
    near, together = HypothesisFit(effects, base).nearby_slopes, (*effects, score.placed)
    short = replace(problem, iterations=min(SELECTION.trial_iterations, problem.iterations))
    fits = []
    for x in score.starts[:starts]:
        start = _scale_start(problem, together, base, x)
        fits.append(short.fit(together, start, base.starts, near, brief=True))
    return HypothesisFit(together, min(fits, key=lambda fit: fit.cost))


def continue_fit(problem: EstimationProblem, hypothesis: HypothesisFit) -> HypothesisFit:
    """Continue a fit to the iterations and the tolerance of the problem."""
    fit, near = hypothesis.fit, hypothesis.nearby_slopes
    return replace(hypothesis, fit=problem.fit(hypothesis.effects, fit.x, fit.starts, near))
