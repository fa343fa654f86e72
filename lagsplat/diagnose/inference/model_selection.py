"""Which effects explain a record best: screen all, fit the promising, then look for a second and a third."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import label, mean

from lagsplat.diagnose.core.config import SELECTION, DiagnoseConfig
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation.multiple_shooting import ShootingFit
from lagsplat.diagnose.inference.evidence import HypothesisFit, log_evidence
from lagsplat.diagnose.inference.problem import EstimationProblem
from lagsplat.diagnose.inference.score_test import ScoreTestResult, score_test

ProgressCallback = Callable[[str], None]


@dataclass(frozen=True)
class SearchBudget:
    """How far the search goes: families and places fitted in full, and beginnings of each fit."""

    families: int
    places: int
    starts: int
    always_fitted: tuple[str, ...]
    """Families that are fitted whatever the score test says."""
    effective_sample_ratio: float
    """Over how many samples of the residual an independent one comes, at least."""
    nominal: float
    """Mean square of the residual, in units of the noise, that the sim leaves of its own recordings."""
    log_evidence_offset: float = 0.0
    """Nats that effects gain where there are none, by the sim's own errors; so much counts for nothing."""

    @classmethod
    def of(
        cls, config: DiagnoseConfig, *, nominal: float, log_evidence_offset: float = 0.0
    ) -> "SearchBudget":
        """What the settings say."""
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
    """`none`, and every hypothesis that was fitted, the most evident first."""

    none: HypothesisFit
    found: tuple[HypothesisFit, ...]
    noise_inflation: float
    """By how much the noise is widened so that the best hypothesis fits."""

    def best_fit(self, name: str) -> HypothesisFit | None:
        """The most evident fit of one family."""
        return next((one for one in self.found if one.effects[-1].effect.name == name), None)


def rank_hypotheses(
    problem: EstimationProblem,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    *,
    known: HypothesisFit | None = None,
    report_progress: ProgressCallback = lambda name: None,
) -> ModelRanking:
    """Every family of ``candidates`` beside the ``known`` effects; without these, beside none.

    Leads come from two score tests: where the uncertainties have moved to make up for the gap, and where
    they have not. The first is blind to an effect that they imitate.
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
        if unmoved.misfit > 1.02 * base.fit.misfit:
            beginnings.append(replace(unmoved, x=np.zeros(n)))
    by_family: dict[str, list[tuple[ScoreTestResult, HypothesisFit]]] = {}
    orders = []
    for fit in beginnings:
        leads = score_test(problem, base.effects, fit, candidates)
        order = list(dict.fromkeys(lead.instance.effect.name for lead in leads))
        orders.append(order[: budget.families])
        for lead in leads:
            family = by_family.setdefault(lead.instance.effect.name, [])
            if (
                sum(one.instance is lead.instance for one, _ in family) == 0
                and len(family) < budget.places * 2
            ):
                family.append((lead, HypothesisFit(base.effects, fit)))
    chosen = list(dict.fromkeys([name for row in zip(*orders, strict=False) for name in row]
                                + [name for order in orders for name in order]
                                + [name for name in budget.always_fitted if name in by_family]))  # fmt: skip
    found = []
    for name in chosen:
        report_progress(name)
        family = sorted(by_family[name], key=lambda pair: -pair[0].gain)[: budget.places]
        for lead, start in family:
            found.append(fit_candidate(problem, base.effects, start.fit, lead, starts=budget.starts))
    found.sort(key=lambda one: one.fit.cost)
    found[: SELECTION.refined_fits] = [refine_fit(problem, one) for one in found[: SELECTION.refined_fits]]
    return rank_by_evidence(problem, base, found, candidates, budget, first=known is None)


def refine_fit(problem: EstimationProblem, one: HypothesisFit) -> HypothesisFit:
    """A fit carried on to its end, beyond the steps and the gain with which every fit must make do."""
    longer = replace(
        problem,
        iterations=SELECTION.refined_iterations * problem.iterations,
        tolerance=SELECTION.refined_tolerance * problem.tolerance,
    )
    near = (one.fit.slopes[..., one.n_effect_parameters :], one.fit.start_slopes) if one.effects else None
    return replace(one, fit=longer.fit(one.effects, one.fit.x, one.fit.starts, near))


def rank_by_evidence(
    problem: EstimationProblem,
    base: HypothesisFit,
    found: Sequence[HypothesisFit],
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    *,
    first: bool,
) -> ModelRanking:
    """Evidence of each fit over the base, under noise as wide as the best of them needs."""
    least = min([one.fit.misfit for one in found] + [base.fit.misfit])
    noisy = _explain_by_sample_noise(problem, base, candidates) if first else []
    explained = max(noisy, key=lambda row: row[0], default=(0.0, base))[1].fit.misfit
    noise_inflation = (
        max(budget.nominal, min(least, explained) / problem.degrees_of_freedom)
        * budget.effective_sample_ratio
    )
    floor = log_evidence(base, problem.rollout_model, noise_inflation) + (
        budget.log_evidence_offset if first else 0.0
    )
    rows = [
        replace(one, log_evidence=log_evidence(one, problem.rollout_model, noise_inflation) - floor)
        for one in found
    ]
    rows += [
        replace(one, log_evidence=gain / budget.effective_sample_ratio - 4.0 - budget.log_evidence_offset)
        for gain, one in noisy
    ]
    rows.sort(key=lambda one: -one.log_evidence)
    return ModelRanking(replace(base, log_evidence=0.0), tuple(rows), noise_inflation)


def _repeated_sample_misfit(problem: EstimationProblem, base: HypothesisFit) -> tuple[float, int]:
    """By how much repeats of an earlier sample miss what should have been seen, and how many do."""
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
    """Effects that only move single samples, judged by the residual of the base."""
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
    """Unknowns to begin from: as much of the promised amplitude as the full rollouts welcome."""
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
    lead: ScoreTestResult,
    *,
    starts: int,
) -> HypothesisFit:
    """The best fit of ``effects`` and the lead's one, from the best few beginnings."""
    known = sum(len(e.effect.parameters) for e in effects)
    near = (base.slopes[..., known:], base.start_slopes)
    best: ShootingFit | None = None
    for x in lead.starts[:starts]:
        whole = _scale_start(problem, effects, base, lead.instance, x)
        fit = problem.fit((*effects, lead.instance), whole, base.starts, near)
        if best is None or fit.cost < best.cost:
            best = fit
    assert best is not None
    return HypothesisFit((*effects, lead.instance), best)
