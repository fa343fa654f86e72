"""Rank single effects: a score test of all, full fits of the best, and the evidence of each fit."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Int64
from scipy.ndimage import label, mean

from lagsplat.diagnose.core.config import SELECTION, DiagnoseConfig
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation import multiple_shooting as shooting
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, compute_log_evidence
from lagsplat.diagnose.inference.score_test import ScoreTestResult, score_test, select_windows


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

    def narrow(self, *, continued: int, refined: int) -> "SearchBudget":
        """Half of the effects, those with the best score tests, each at one place and from one start."""
        families = max(SELECTION.min_families, self.config.families // 2)
        config = replace(self.config, families=families, places=1, starts=1, always_fitted=[])
        return replace(self, config=config, continued=continued, refined=refined)


@dataclass(frozen=True)
class ModelRanking:
    """`none` and every fitted hypothesis, by falling log evidence."""

    none: HypothesisFit
    found: tuple[HypothesisFit, ...]
    noise_inflation: float  # factor on the variance of the noise [1] at which the best hypothesis fits
    information: Mapping[str, float] = field(default_factory=dict)
    """By effect, the log evidence that one as large as its prior's standard deviation would have [nat]."""

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

    Over a long window a large gap is far from linear in the parameters, and fits stay where they start. So
    where no effect explains the gap, all are tried once more from shorter windows, see `lengthen_horizon`.
    """
    zeros = np.zeros(problem.rollout_model.nuisance.size)
    base = known or refine_fit(problem, HypothesisFit((), problem.fit((), zeros)))
    enough = SELECTION.inflation_misfit * budget.nominal * problem.degrees_of_freedom
    begun, information = begin_fits([problem], base, candidates, budget, report_progress=report_progress)
    found = [continue_fit(problem, hypothesis) for hypothesis in begun]
    if known is None and min(hypothesis.fit.misfit for hypothesis in (base, *found)) > enough:
        horizons = [problem, half := problem.halve_windows(), half.halve_windows()]
        other = lengthen_horizon(horizons, replace(base, fit=replace(base.fit, x=zeros)))
        base = min(base, refine_fit(problem, other), key=lambda hypothesis: hypothesis.fit.cost)
        again, _ = begin_fits(horizons, base, candidates, budget, report_progress=report_progress)
        best: dict[int, HypothesisFit] = {}
        for hypothesis in [*found, *(continue_fit(problem, hypothesis) for hypothesis in again)]:
            place = id(hypothesis.effects[-1])
            best[place] = min(best.get(place, hypothesis), hypothesis, key=lambda each: each.fit.cost)
        found = list(best.values())
    found.sort(key=lambda hypothesis: hypothesis.fit.cost)
    refined = [refine_fit(problem, hypothesis) for hypothesis in found[: budget.refined]]
    ranking = rank_by_evidence(problem, base, [*refined, *found[budget.refined :]], candidates, budget)
    return replace(ranking, information=information)


def begin_fits(
    horizons: Sequence[EstimationProblem],
    base: HypothesisFit,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    *,
    report_progress: Callable[[str], None],
) -> tuple[list[HypothesisFit], dict[str, float]]:
    """Brief fits of the candidates beside ``base``, to be continued, on the longest of the ``horizons``.
    Beside them, `ModelRanking.information`.

    Two score tests choose what is fitted and where fits start: one with the nuisance parameters fitted to the
    gap, one with them held at zero. The first cannot see an effect that the nuisance parameters imitate, and
    a fit that starts there may stay there. Both are on the shortest horizon.
    """
    tried, zeros = horizons[-1], np.zeros(horizons[0].rollout_model.nuisance.size)
    beside = base.fit if len(horizons) == 1 else tried.fit(base.effects, base.fit.x)
    beginnings = [(tried, beside)]
    if not base.effects:
        frozen = tried.with_nuisance(tried.rollout_model.nuisance.freeze())
        unmoved = frozen.fit((), zeros)
        if unmoved.misfit > SELECTION.unmoved_misfit_ratio * beside.misfit:
            beginnings.append((frozen, replace(unmoved, x=zeros)))
    most = SELECTION.tested_windows * 2 ** (len(horizons) - 1)
    config, windows = budget.config, shooting.choose_windows(beside, tried.windows.length, most)
    tests = [score_test(each, base.effects, fit, candidates, windows) for each, fit in beginnings]
    names = interleave([list(dict.fromkeys(test.name for test in row))[: config.families] for row in tests])
    names += [name for name in config.always_fitted if any(test.name == name for test in tests[0])]
    found = []
    for name in dict.fromkeys(names):
        report_progress(name)
        by_place: dict[int, list[ScoreTestResult]] = {}
        for test in interleave([[test for test in row if test.name == name] for row in tests]):
            by_place.setdefault(id(test.placed), []).append(test)
        places = list(by_place.values())
        variants = places[0][0].placed.effect.variants
        for place in places[: config.places * len(variants)]:
            found.append(try_candidate(tried, base.effects, place, starts=config.starts, windows=windows))
    best = sorted(found, key=lambda hypothesis: hypothesis.fit.cost)[: budget.continued]
    seen = float(tried.windows.length.sum() / tried.windows.length[windows].sum())
    scale = seen / (budget.nominal * budget.effective_sample_ratio)
    information: dict[str, float] = {}
    for test in tests[0]:
        information[test.name] = max(information.get(test.name, 0.0), scale * test.information)
    return [lengthen_horizon(horizons, hypothesis) for hypothesis in best], information


def interleave(rows: Sequence[Sequence[Any]]) -> list[Any]:
    """The first of every row, then the second of every row, and so on."""
    longest = max((len(row) for row in rows), default=0)
    return [row[k] for k in range(longest) for row in rows if k < len(row)]


def lengthen_horizon(horizons: Sequence[EstimationProblem], hypothesis: HypothesisFit) -> HypothesisFit:
    """A few steps of a fit on each horizon, the shortest first, from the parameters of the ``hypothesis``.

    The initial states are the measured ones, then those of the fit before. With one horizon nothing changes.

    Source: Ribeiro, Tiels, Umenberger, Schon and Aguirre, "On the smoothness of nonlinear system
    identification", 2020, doi:10.1016/j.automatica.2020.109158.
    """
    if len(horizons) == 1:
        return hypothesis
    fit, shortest = hypothesis.fit, horizons[-1]
    states = dict(zip(shortest.windows.first.tolist(), shortest.initial_states, strict=True))
    for horizon in reversed(horizons):
        first = horizon.windows.first.tolist()
        few = replace(horizon, iterations=min(SELECTION.trial_iterations, horizon.iterations))
        fit = few.fit(hypothesis.effects, fit.x, np.array([states[frame] for frame in first]), brief=True)
        states = dict(zip(first, fit.starts, strict=True))
    return replace(hypothesis, fit=fit)


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
    speed = problem.windows.take(record.v) / problem.deviation * record.dt_s
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
    known, amplitudes = sum(placed.size for placed in effects[:-1]), effects[-1].effect.amplitudes
    if not len(amplitudes):
        return np.concatenate([base.x[:known], x, base.x[known:]])
    tried = np.repeat(x[None], len(SELECTION.start_shares), axis=0)
    tried[:, amplitudes] *= np.array(SELECTION.start_shares)[:, None]
    whole = np.stack([np.concatenate([base.x[:known], row, base.x[known:]]) for row in tried])
    y = problem.predict(effects)(whole, np.repeat(base.starts[None], len(whole), axis=0))
    misfit = np.sum(((problem.data.y - y) * problem.data.weight) ** 2, axis=(1, 2, 3))
    return whole[int(np.argmin(np.where(np.isfinite(misfit), misfit, np.inf)))]


def try_candidate(
    problem: EstimationProblem,
    effects: tuple[PlacedEffect, ...],
    tests: Sequence[ScoreTestResult],
    *,
    starts: int,
    windows: Int64[np.ndarray, " V"] | None = None,
) -> HypothesisFit:
    """A few steps of a fit of one candidate beside ``effects``, from its ``starts`` best starting points; the
    best of these fits, to be continued.

    ``tests`` are of the same candidate at one place, beside one or several fits of ``effects``. Where not all
    ``windows`` are fitted, the others have the initial states of the fit of ``effects``.
    """
    together = (*effects, tests[0].placed)
    fits = []
    for test, x in interleave([[(test, x) for x in test.starts] for test in tests])[:starts]:
        part, base = select_windows(problem, test.base, windows)
        start, near = _scale_start(part, together, base, x), HypothesisFit(effects, base).nearby_slopes
        short = replace(part, iterations=min(SELECTION.trial_iterations, part.iterations))
        fits.append((short.fit(together, start, base.starts, near, brief=True), test.base))
    fit, base = min(fits, key=lambda pair: pair[0].cost)
    if windows is None or len(fit.starts) == len(base.starts):
        return HypothesisFit(together, fit)
    every = base.starts.copy()
    every[windows] = fit.starts
    # derivatives by the effects are computed anew when the fit is continued
    known, start_slopes = HypothesisFit(effects, base).nearby_slopes
    unknown = np.zeros((*known.shape[:2], len(fit.x) - known.shape[2]))
    slopes = np.concatenate([unknown, known], axis=2)
    return HypothesisFit(together, replace(fit, starts=every, slopes=slopes, start_slopes=start_slopes))


def continue_fit(problem: EstimationProblem, hypothesis: HypothesisFit) -> HypothesisFit:
    """Continue a fit to the iterations and the tolerance of the problem."""
    fit, near = hypothesis.fit, hypothesis.nearby_slopes
    return replace(hypothesis, fit=problem.fit(hypothesis.effects, fit.x, fit.starts, near))
