"""Rank single effects: a score test of all, full fits of the best, and the evidence of each fit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import label, mean

from lagsplat.diagnose.core.config import SELECTION, DiagnoseConfig
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation.multiple_shooting import ShootingFit
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, compute_log_evidence
from lagsplat.diagnose.inference.score_test import ScoreTestResult, score_test

ProgressCallback = Callable[[str], None]


@dataclass(frozen=True)
class SearchBudget:
    """How many hypotheses are fitted in full, and what their evidence is measured against."""

    families: int  # effects that are fitted [count]
    places: int  # coordinates or inputs at which each is fitted [count]
    starts: int  # starting points of each fit [count]
    always_fitted: tuple[str, ...]  # effects that are fitted whatever the score test says
    effective_sample_ratio: float
    """Samples of the residual that count as one independent sample, at least [1]."""
    nominal: float  # mean square residual of the sim on its own recordings [noise variances]
    log_evidence_offset: float = 0.0
    """Log evidence that effects gain by the sim's own errors [nat]; it is subtracted."""

    @classmethod
    def of(
        cls, config: DiagnoseConfig, *, nominal: float, log_evidence_offset: float = 0.0
    ) -> "SearchBudget":
        """The budget that the settings give."""
        return cls(
            config.families,
            config.places,
            config.starts,
            tuple(config.always_fitted),
            config.effective_sample_ratio,
            nominal,
            log_evidence_offset,
        )


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
    report_progress: ProgressCallback = lambda name: None,
) -> ModelRanking:
    """Rank the candidates, each added to the ``known`` effects.

    Two score tests choose what is fitted: one with the nuisance parameters fitted to the gap, one with them
    at zero. The first cannot see an effect that the nuisance parameters imitate.
    """
    n = problem.rollout_model.nuisance.size
    base = known or refine_fit(problem, HypothesisFit((), problem.fit((), np.zeros(n))))
    beginnings = [base.fit]
    if known is None:
        frozen = replace(
            problem,
            rollout_model=replace(problem.rollout_model, nuisance=problem.rollout_model.nuisance.freeze()),
        )
        unmoved = frozen.fit((), np.zeros(n))
        if unmoved.misfit > SELECTION.unmoved_misfit_ratio * base.fit.misfit:
            beginnings.append(replace(unmoved, x=np.zeros(n)))
    by_family: dict[str, list[tuple[ScoreTestResult, HypothesisFit]]] = {}
    orders = []
    for fit in beginnings:
        scores = score_test(problem, base.effects, fit, candidates)
        order = list(dict.fromkeys(score.placed.effect.name for score in scores))
        orders.append(order[: budget.families])
        for score in scores:
            family = by_family.setdefault(score.placed.effect.name, [])
            is_new = all(previous.placed is not score.placed for previous, _ in family)
            if is_new and len(family) < budget.places * 2:
                family.append((score, HypothesisFit(base.effects, fit)))
    names = [name for row in zip(*orders, strict=False) for name in row]
    names += [name for order in orders for name in order]
    names += [name for name in budget.always_fitted if name in by_family]
    found = []
    for name in dict.fromkeys(names):
        report_progress(name)
        family = sorted(by_family[name], key=lambda pair: -pair[0].gain)[: budget.places]
        for score, start in family:
            found.append(fit_candidate(problem, base.effects, start.fit, score, starts=budget.starts))
    found.sort(key=lambda hypothesis: hypothesis.fit.cost)
    found[: SELECTION.refined_fits] = [
        refine_fit(problem, hypothesis) for hypothesis in found[: SELECTION.refined_fits]
    ]
    return rank_by_evidence(problem, base, found, candidates, budget, first=known is None)


def refine_fit(problem: EstimationProblem, hypothesis: HypothesisFit) -> HypothesisFit:
    """Continue a fit to convergence, with more iterations and a smaller tolerance than the first pass."""
    longer = replace(
        problem,
        iterations=SELECTION.refined_iterations * problem.iterations,
        tolerance=SELECTION.refined_tolerance * problem.tolerance,
    )
    near = (
        (hypothesis.fit.slopes[..., hypothesis.n_effect_parameters :], hypothesis.fit.start_slopes)
        if hypothesis.effects
        else None
    )
    return replace(
        hypothesis, fit=longer.fit(hypothesis.effects, hypothesis.fit.x, hypothesis.fit.starts, near)
    )


def rank_by_evidence(
    problem: EstimationProblem,
    base: HypothesisFit,
    found: Sequence[HypothesisFit],
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    *,
    first: bool,
) -> ModelRanking:
    """Rank fits by their log evidence over the base, all under one noise inflation.

    The noise is inflated until the best fit agrees with it.

    Args:
        problem: data, sim and noise.
        base: the fit without the new effects.
        found: fits with them.
        candidates: effects at their places; those on single samples are judged by the residual of the base.
        budget: nominal misfit, effective sample ratio and evidence offset.
        first: whether the base has no effects.
    """
    least = min([hypothesis.fit.misfit for hypothesis in found] + [base.fit.misfit])
    noisy = _explain_by_sample_noise(problem, base, candidates) if first else []
    explained = max(noisy, key=lambda row: row[0], default=(0.0, base))[1].fit.misfit
    noise_inflation = (
        max(budget.nominal, min(least, explained) / problem.degrees_of_freedom)
        * budget.effective_sample_ratio
    )
    floor = compute_log_evidence(base, problem.rollout_model, noise_inflation) + (
        budget.log_evidence_offset if first else 0.0
    )
    rows = [
        replace(
            hypothesis,
            log_evidence=compute_log_evidence(hypothesis, problem.rollout_model, noise_inflation) - floor,
        )
        for hypothesis in found
    ]
    rows += [
        replace(
            hypothesis,
            log_evidence=gain / budget.effective_sample_ratio
            - SELECTION.sample_noise_penalty
            - budget.log_evidence_offset,
        )
        for gain, hypothesis in noisy
    ]
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


def _lag_one_correlation(residual: np.ndarray, mask: np.ndarray) -> float:
    """Correlation of the residual (windows, samples, d) from one sample to the next."""
    seen = np.where(mask[..., None], residual, 0.0)
    return float((seen[:, 1:] * seen[:, :-1]).sum() / max((seen**2).sum(), np.finfo(float).tiny))


def _explain_by_sample_noise(
    problem: EstimationProblem, base: HypothesisFit, candidates: Sequence[PlacedEffect]
) -> list[tuple[float, HypothesisFit]]:
    """Gain of misfit by each effect on single samples, from the residual of the base."""
    out = []
    mask = problem.data.weight[..., 0] > 0.0  # a frame shows all coordinates or none
    for candidate in candidates:
        if not isinstance(candidate.effect, SampleEffect):
            continue
        v = (
            problem.windows.take(problem.rollout_model.dataset.v)
            / problem.sigma
            * problem.rollout_model.dataset.dt_s
        )
        gain, parameters, misfit = candidate.effect.explain(base.fit.residual[mask], v[mask])
        gain *= min(
            max(0.0, 1.0 - _lag_one_correlation(base.fit.residual, mask) / SELECTION.max_noise_correlation),
            1.0,
        )
        if candidate.effect.repeats:
            missed, n = _repeated_sample_misfit(problem, base)
            gain += 0.5 * missed
            parameters = {key: tuple(value + n for value in row) for key, row in parameters.items()}
        fit = replace(base.fit, misfit=misfit)
        out.append((gain, HypothesisFit((*base.effects, candidate), fit, noise=parameters)))
    return out


def _scale_start(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    base: ShootingFit,
    candidate: PlacedEffect,
    x: np.ndarray,
) -> np.ndarray:
    """Parameters to start from: the share of the score test's amplitude that full rollouts fit best."""
    known, n = sum(len(e.effect.parameters) for e in effects), candidate.effect.amplitudes
    tried = np.repeat(x[None], len(SELECTION.start_shares) if n else 1, axis=0)
    if n:
        tried[:, :n] *= np.array(SELECTION.start_shares)[:, None]
    whole = np.stack([np.concatenate([base.x[:known], row, base.x[known:]]) for row in tried])
    if not n:
        return whole[0]
    y = problem.predict((*effects, candidate))(whole, np.repeat(base.starts[None], len(whole), axis=0))
    misfit = np.sum(((problem.data.y - y) * problem.data.weight) ** 2, axis=(1, 2, 3))
    return whole[int(np.argmin(np.where(np.isfinite(misfit), misfit, np.inf)))]


def fit_candidate(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    base: ShootingFit,
    score: ScoreTestResult,
    *,
    starts: int,
) -> HypothesisFit:
    """Fit one candidate beside ``effects`` from its best few starting points, and return the best fit."""
    known = sum(len(e.effect.parameters) for e in effects)
    near = (base.slopes[..., known:], base.start_slopes)
    best: ShootingFit | None = None
    for x in score.starts[:starts]:
        whole = _scale_start(problem, effects, base, score.placed, x)
        fit = problem.fit((*effects, score.placed), whole, base.starts, near)
        if best is None or fit.cost < best.cost:
            best = fit
    assert best is not None
    return HypothesisFit((*effects, score.placed), best)
