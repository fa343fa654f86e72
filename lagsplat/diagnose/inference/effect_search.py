"""The search for effects: single ones, then pairs and triples as long as these explain enough more."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.inference.model_selection import ModelRanking, SearchBudget, rank_hypotheses
from lagsplat.diagnose.inference.posterior import combine_effects
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from lagsplat.diagnose.inference.robustness import inflate_noise


@dataclass(frozen=True)
class EffectSearch:
    """What was searched, and what was found: the fits of single effects and of growing sets."""

    problem: EstimationProblem
    candidates: tuple[PlacedEffect, ...]
    budget: SearchBudget
    ranking: ModelRanking
    sets: tuple[HypothesisFit, ...]

    def leave_out(self, names: Sequence[str]) -> "EffectSearch":
        """The same search without the effects ``names``; the other single effects are not fitted again."""
        found = tuple(fit for fit in self.ranking.found if fit.name not in names)
        candidates = tuple(each for each in self.candidates if each.effect.name not in names)
        ranking = replace(self.ranking, found=found)
        sets = combine_effects(self.problem, ranking, candidates, self.budget)
        return replace(self, candidates=candidates, ranking=ranking, sets=sets)


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
    sets = combine_effects(problem, ranking, candidates, budget, report_progress=report_progress)
    inflated = inflate_noise(problem, budget, sets[-1] if sets else ranking.none)
    if inflated is not None:
        problem, budget = inflated
        ranking = rank_hypotheses(problem, candidates, budget, report_progress=report_progress)
        sets = combine_effects(problem, ranking, candidates, budget, report_progress=report_progress)
    return EffectSearch(problem, tuple(candidates), budget, ranking, sets)
