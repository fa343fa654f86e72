"""The search for effects: single ones, then pairs and triples as long as these have more evidence.

Where the best explanation misses by many times the noise, the laws are wrong, and their errors are correlated
over many samples. Taken as white noise, these samples would outweigh the priors: the nuisance parameters
would move by hundreds of standard deviations to close the gap, and `none` would look good. So the remaining
misfit counts as noise, correlated samples count as one, and all is fitted again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.core.config import SELECTION
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.estimation.multiple_shooting import compute_autocorrelation_time, measure_windows
from lagsplat.diagnose.inference.model_selection import ModelRanking, SearchBudget, rank_hypotheses
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    HypothesisFit,
    compute_excess_penalty,
    compute_log_evidence,
)


@dataclass(frozen=True)
class EffectSearch:
    """What was searched, and what was found: the fits of single effects and of growing sets.

    ``sets`` are the best single effect, pair and triple; ``rivals`` are other pairs and triples, with less
    evidence.
    """

    problem: EstimationProblem
    candidates: tuple[PlacedEffect, ...]
    budget: SearchBudget
    ranking: ModelRanking
    sets: tuple[HypothesisFit, ...]
    rivals: tuple[HypothesisFit, ...] = ()


def search_effects(
    problem: EstimationProblem,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    *,
    report_progress: Callable[[str], None] = lambda name: None,
) -> EffectSearch:
    """Fit single effects, then sets of two and three.

    Where no effect fits, the noise is larger than it was taken for, and all are fitted again under it.
    """
    ranking = rank_hypotheses(problem, candidates, budget, report_progress=report_progress)
    sets, rivals = combine_effects(problem, ranking, candidates, budget, report_progress=report_progress)
    inflated = inflate_noise(problem, budget, sets[-1] if sets else ranking.none)
    if inflated is not None:
        problem, budget = inflated
        ranking = rank_hypotheses(problem, candidates, budget, report_progress=report_progress)
        sets, rivals = combine_effects(problem, ranking, candidates, budget, report_progress=report_progress)
    return EffectSearch(problem, tuple(candidates), budget, ranking, sets, rivals)


def list_probable_effects(ranking: ModelRanking) -> list[HypothesisFit]:
    """The best fit of every effect that has more evidence than `none`, the one with the most first.

    The evidence of an effect counts less by the logarithm of the number of its places, as only one is right.
    """
    best: dict[str, HypothesisFit] = {}
    places: dict[str, int] = {}
    for fit in ranking.found:
        best.setdefault(fit.name, fit)
        places[fit.name] = places.get(fit.name, 0) + 1
    evidence = {name: fit.log_evidence - float(np.log(places[name])) for name, fit in best.items()}
    return [best[name] for name in sorted(best, key=lambda name: -evidence[name]) if evidence[name] > 0.0]


def combine_effects(
    problem: EstimationProblem,
    ranking: ModelRanking,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    *,
    report_progress: Callable[[str], None] = lambda name: None,
) -> tuple[tuple[HypothesisFit, ...], tuple[HypothesisFit, ...]]:
    """The best single effect, pair and triple, as long as a larger set has more evidence, and their rivals.

    A second effect is sought beside each of the best few single effects, so that the pair may hold another
    first effect than the best single one. Half of the budget's families are fitted. Other sets that were
    fitted to their end are rivals. Both are empty where nothing beats `none`.
    """
    singles = list_probable_effects(ranking)
    if not singles:
        return (), ()
    firsts = [fit for fit in singles if fit.effects[-1].changes_motion]
    narrow = budget.narrow(continued=SELECTION.continued_sets, refined=SELECTION.refined_sets)
    ratio, freedom = budget.effective_sample_ratio, problem.degrees_of_freedom
    chain = [singles[0]]
    rivals: list[HypothesisFit] = []
    while len(chain) < SELECTION.max_effects and (
        chain[-1].fit.misfit / freedom - budget.nominal > SELECTION.min_excess
        or compute_excess_penalty(chain[-1].fit, budget.nominal * ratio) > 0.0
    ):
        larger = []
        for known in firsts[: SELECTION.max_first_effects] if len(chain) == 1 else chain[-1:]:
            names = {placed.effect.name for placed in known.effects}
            others = [candidate for candidate in candidates if candidate.effect.name not in names]
            more = rank_hypotheses(problem, others, narrow, known=known, report_progress=report_progress)
            moving = [fit for fit in more.found if fit.effects[-1].changes_motion]
            larger += moving[: SELECTION.continued_sets]
        if not larger:
            break
        least = min(fit.fit.misfit for fit in larger) / freedom
        noise_inflation = max(budget.nominal, least) * ratio

        def measure(fit: HypothesisFit, noise_inflation: float = noise_inflation) -> float:
            if fit.moves_samples:
                return fit.log_evidence
            model, none = problem.rollout_model, ranking.none
            base = compute_log_evidence(none, model, noise_inflation)
            return compute_log_evidence(fit, model, noise_inflation) - base

        distinct = _list_distinct_sets(sorted(larger, key=measure, reverse=True))
        best = distinct[0]
        gain = measure(best) - measure(chain[-1])
        rivals += distinct[1:] if gain > 0.0 else distinct
        if gain <= 0.0:
            break
        chain.append(replace(best, log_evidence=chain[-1].log_evidence + gain))
    return tuple(chain), tuple(rivals)


def _list_distinct_sets(fits: Sequence[HypothesisFit]) -> list[HypothesisFit]:
    """The first fit of every set of effects, in whatever order these were added."""
    first: dict[frozenset[str], HypothesisFit] = {}
    for fit in fits:
        first.setdefault(frozenset(placed.effect.name for placed in fit.effects), fit)
    return list(first.values())


def inflate_noise(
    problem: EstimationProblem, budget: SearchBudget, best: HypothesisFit
) -> tuple[EstimationProblem, SearchBudget] | None:
    """Inflate the noise to the misfit that the ``best`` explanation leaves; None if that is nearly nominal.

    The median over the windows counts: a push by hand in a few of them is no error of the law.
    """
    length = problem.windows.length
    typical = float(np.median(measure_windows(best.fit.residual, length)))
    misfit = min(best.fit.misfit / problem.degrees_of_freedom, typical)
    if misfit <= SELECTION.inflation_misfit * budget.nominal:
        return None
    correlation = compute_autocorrelation_time(best.fit.residual, length)
    noise_inflation = max(problem.noise_inflation, misfit * correlation)
    return replace(problem, noise_inflation=noise_inflation), replace(budget, correlation=correlation)
