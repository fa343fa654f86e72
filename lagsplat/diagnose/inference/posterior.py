"""From log evidence to probabilities and a verdict; sets of several effects; reasons against an explanation.

A push at a given time explains anything that happens once. That it is external shows only where the mechanism
passes through the same state again without it, and that a force is periodic only where it repeats. An effect
with many parameters imitates a sim whose parameters are all somewhat wrong. Where the sim with relaxed priors
fits as well, with more evidence, the effect is not the cause.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from lagsplat.diagnose.core.config import IMPLAUSIBILITY, SELECTION, VERDICT, DiagnoseConfig
from lagsplat.diagnose.core.result import Verdict
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.effects.registry import catalogue, find_confusable
from lagsplat.diagnose.inference.model_selection import ModelRanking, SearchBudget, rank_hypotheses
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    HypothesisFit,
    compute_excess_penalty,
    compute_log_evidence,
)


@dataclass(frozen=True)
class GapMeasure:
    """How much of the gap an explanation leaves [noise variances, as a mean square of the residual]."""

    freedom: float  # degrees of freedom of the residual
    nominal: float  # mean square residual of the sim on its own recordings
    config: DiagnoseConfig

    def compute_excess_penalty(self, hypothesis: HypothesisFit) -> float:
        """Penalty of nuisance parameters that moved further than their prior allows, as part of a misfit."""
        return compute_excess_penalty(hypothesis.fit, self.nominal * self.config.effective_sample_ratio)

    def compute_unexplained(self, hypothesis: HypothesisFit) -> float:
        """Mean square above the nominal one; what nuisance parameters explain beyond their prior counts."""
        misfit = hypothesis.fit.misfit + self.compute_excess_penalty(hypothesis)
        return misfit / self.freedom - self.nominal

    @property
    def detectable(self) -> float:
        """Detectable excess of the mean square, by errors of a right law and by chance."""
        spread = np.sqrt(2.0 * self.config.effective_sample_ratio / max(self.freedom, 1.0))
        return float(VERDICT.law_error * self.nominal + VERDICT.detectable_deviations * self.nominal * spread)

    def compute_unknown_probability(self, unexplained: float, before: float) -> float:
        """P(unknown), logistic in the logarithm of the share of ``before`` that is left unexplained."""
        excess = unexplained - self.detectable
        if excess <= 0.0:
            return VERDICT.min_unknown
        share = min(excess / max(before, excess), 1.0)
        odds = (self.config.unknown_midpoint / share) ** VERDICT.unknown_exponent
        return max(float(1.0 / (1.0 + odds)), VERDICT.min_unknown)


def combine_effects(
    problem: EstimationProblem,
    ranking: ModelRanking,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    *,
    report_progress: Callable[[str], None] = lambda name: None,
) -> tuple[HypothesisFit, ...]:
    """The best single effect, pair and triple, as long as a larger set explains enough more.

    A second effect is sought beside each of the best few single effects, so that the pair may hold another
    first effect than the best single one. Half of the budget's families are fitted. Empty where nothing beats
    `none`.
    """
    config = budget.config
    singles = select_probable_effects(ranking, config)
    if not singles:
        return ()
    firsts = [fit for fit in singles if fit.effects[-1].changes_motion]
    families = max(3, config.families // 2)
    narrow = replace(
        budget,
        config=replace(config, families=families, places=1, starts=1, always_fitted=[]),
        continued=SELECTION.continued_sets,
        refined=SELECTION.refined_sets,
    )
    freedom = problem.degrees_of_freedom
    gap = GapMeasure(freedom, budget.nominal, config)
    chain = [singles[0]]
    while len(chain) < SELECTION.max_effects and (
        chain[-1].fit.misfit / freedom - budget.nominal > SELECTION.min_excess
        or gap.compute_excess_penalty(chain[-1]) > 0.0
    ):
        larger = []
        for known in firsts[: SELECTION.max_first_effects] if len(chain) == 1 else chain[-1:]:
            names = {placed.effect.name for placed in known.effects}
            others = [candidate for candidate in candidates if candidate.effect.name not in names]
            more = rank_hypotheses(problem, others, narrow, known=known, report_progress=report_progress)
            added = next((fit for fit in more.found if fit.effects[-1].changes_motion), None)
            if added is not None:
                larger.append(replace(added, log_evidence=known.log_evidence + added.log_evidence))
        if not larger:
            break
        least = min(fit.fit.misfit for fit in larger) / freedom
        noise_inflation = max(budget.nominal, least) * budget.effective_sample_ratio
        best = max(larger, key=lambda fit: compute_log_evidence(fit, problem.rollout_model, noise_inflation))
        # the share above the noise floor; the cost includes the penalty of the nuisance parameters
        floor = budget.nominal * freedom
        if best.fit.cost - floor > (1.0 - config.second_effect_share) * (chain[-1].fit.cost - floor):
            break
        chain.append(best)
    return tuple(chain)


def evidence_temperature(ranking: ModelRanking) -> float:
    """Factor in (0, 1] on every log evidence, because the laws of the catalogue are approximate.

    Where the best effect gains thousands of nats, an error of one per cent in its law moves tens of nats.
    With this factor no log evidence counts more than `VERDICT.max_log_evidence`.
    """
    most = max((hypothesis.log_evidence for hypothesis in ranking.found), default=0.0)
    return 1.0 / (1.0 + max(most, 0.0) / VERDICT.max_log_evidence)


def _list_names(config: DiagnoseConfig) -> list[str]:
    return [name for name in catalogue() if name not in config.without]


def log_posteriors(ranking: ModelRanking, config: DiagnoseConfig) -> dict[str, float]:
    """Log posterior, up to a constant, of `none` and of every fitted effect at its best place [nat].

    All effects have the same prior probability, whatever the number of their places, less the penalty that
    an effect may have.
    """
    prior = np.log((1.0 - config.prior_none - config.prior_unknown) / len(_list_names(config)))
    scores = {"none": float(np.log(config.prior_none))}
    places: dict[str, int] = {}
    temperature = evidence_temperature(ranking)
    for hypothesis in ranking.found:
        name, placed = hypothesis.name, hypothesis.effects[-1]
        places[name] = places.get(name, 0) + 1
        penalty = placed.effect.log_prior_penalty
        if placed.effect.fitted_penalty is not None:
            penalty += placed.effect.fitted_penalty(hypothesis.name_parameters(placed), placed)
        scores.setdefault(name, float(prior) + temperature * hypothesis.log_evidence - penalty)
    for name, n in places.items():
        scores[name] -= float(np.log(n))
    return scores


def select_probable_effects(ranking: ModelRanking, config: DiagnoseConfig) -> list[HypothesisFit]:
    """The best fit of every effect that is more probable than `none`, the most probable first."""
    scores = log_posteriors(ranking, config)
    best: dict[str, HypothesisFit] = {}
    for hypothesis in ranking.found:
        best.setdefault(hypothesis.name, hypothesis)
    above = [name for name in best if scores[name] > scores["none"]]
    return [best[name] for name in sorted(above, key=lambda name: -scores[name])]


@dataclass(frozen=True)
class Implausibility:
    """A lower bound of P(unknown), and its reason.

    ``unrepeated``: an external force in states that occur only with it. ``shapeless``: several flexible
    effects. ``loose``: the sim with relaxed priors has more evidence.
    """

    chance: float
    why: Literal["unrepeated", "shapeless", "loose"]


def assess_implausibility(
    problem: EstimationProblem, ranking: ModelRanking, hypothesis: HypothesisFit, *, nominal: float
) -> Implausibility:
    """The strongest reason against an explanation; none against effects on single samples."""
    if hypothesis.moves_samples:
        return Implausibility(0.0, "loose")
    ahead = relaxed_model_log_evidence(problem, ranking, hypothesis, nominal=nominal)
    behind = (IMPLAUSIBILITY.relaxed_lead - ahead) / IMPLAUSIBILITY.relaxed_scatter
    loose = float(1.0 / (1.0 + np.exp(np.clip(behind, -50.0, 50.0))))
    unrepeated = IMPLAUSIBILITY.unrepeated_chance * (1.0 - measure_recurrence(hypothesis, problem))
    shapes = sum(placed.effect.flexible for placed in hypothesis.effects)
    reasons = (
        Implausibility(unrepeated, "unrepeated"),
        Implausibility(IMPLAUSIBILITY.flexible_chance if shapes > 1 else 0.0, "shapeless"),
        Implausibility(loose, "loose"),
    )
    return max(reasons, key=lambda reason: reason.chance)


def measure_recurrence(hypothesis: HypothesisFit, problem: EstimationProblem) -> float:
    """How clearly the data show that the external effects of a hypothesis are external, from 0 to 1.

    It is 1 where there are none.
    """
    record, shown = problem.dataset, 1.0
    for placed in hypothesis.effects:
        if placed.effect.recurrence is not None:
            parameters = hypothesis.name_parameters(placed)
            shown = min(shown, placed.effect.recurrence(parameters, record, placed))
    return shown


def relaxed_model_log_evidence(
    problem: EstimationProblem, ranking: ModelRanking, best: HypothesisFit, *, nominal: float
) -> float:
    """Log evidence of the sim with relaxed priors over that of ``best`` [nat].

    Minus infinity where the relaxed sim fits worse, and where the sim misses even its own recordings
    (``nominal`` [noise variances]): then it fits anything.
    """
    if nominal > IMPLAUSIBILITY.max_nominal_misfit:
        return -np.inf
    rollout_model, noise_inflation = problem.rollout_model, ranking.noise_inflation
    loose = problem.with_nuisance(rollout_model.nuisance.scale_mechanics(IMPLAUSIBILITY.relaxation))
    fit = loose.fit((), ranking.none.fit.x, ranking.none.fit.starts)
    noise = nominal * problem.degrees_of_freedom
    if fit.misfit > max(best.fit.misfit, noise) + IMPLAUSIBILITY.relaxed_misfit_margin * noise:
        return -np.inf
    there = compute_log_evidence(HypothesisFit((), fit), loose.rollout_model, noise_inflation)
    return there - compute_log_evidence(best, rollout_model, noise_inflation)


@dataclass(frozen=True)
class Judgement:
    """Probabilities of all names, the most probable first, the best explanation, and the verdict."""

    verdict: Verdict
    probabilities: Mapping[str, float]
    equivalent: tuple[tuple[str, ...], ...]
    unexplained: float  # share of the excess misfit that the best explanation leaves
    best: HypothesisFit | None  # the best explanation, whether or not the verdict names it
    implausibility: str | None = None
    """The reason against it, where the verdict is `unknown` although it explains the gap."""

    @property
    def most_probable(self) -> str:
        """The most probable name."""
        return next(iter(self.probabilities))


def choose_explanation(
    chain: Sequence[HypothesisFit], before: float, gap: GapMeasure
) -> tuple[HypothesisFit | None, float, float]:
    """The effect or set that explains the gap, the share of the gap that it leaves, and P(unknown).

    Two wrong effects imitate nearly anything, and three even more. So a set is chosen only if it leaves less
    than `GapMeasure.detectable` or ``config.sufficient_share``, and both for three effects. Otherwise the
    best single effect is chosen. ``before`` is the gap without effects [noise variances].
    """
    if not chain:
        return None, 1.0, gap.compute_unknown_probability(before, before)
    enough = gap.config.sufficient_share
    unexplained = [gap.compute_unexplained(hypothesis) for hypothesis in chain]
    share = [max(rest, 0.0) / max(before, rest, 1e-9) for rest in unexplained]
    if share[0] > enough or gap.compute_excess_penalty(chain[0]) > 0.0:
        for hypothesis, rest, part in zip(chain[1:], unexplained[1:], share[1:], strict=True):
            required = all if len(hypothesis.effects) > 2 else any
            if required((rest < gap.detectable, part < enough)):
                return hypothesis, part, VERDICT.min_unknown
    return chain[0], share[0], gap.compute_unknown_probability(unexplained[0], before)


def judge_hypotheses(
    ranking: ModelRanking,
    chain: Sequence[HypothesisFit],
    gap: GapMeasure,
    *,
    most: float = np.inf,
    doubt: Callable[[HypothesisFit], Implausibility] = lambda hypothesis: Implausibility(0.0, "loose"),
) -> Judgement:
    """Probabilities of all names by evidence and prior, and the verdict.

    P(unknown) grows with the share that the best explanation of the ``chain``, the best single effect, pair
    and triple, leaves. It is at least the implausibility of that explanation, by ``doubt``. No gap larger
    than ``most`` counts: nearly anything explains most of a diverged rollout.
    """
    scores = log_posteriors(ranking, gap.config)
    before = min(gap.compute_unexplained(ranking.none), most)
    best, unexplained, p_unknown = choose_explanation(chain, before, gap)
    implausibility = doubt(best or ranking.none)
    reason = implausibility.why if implausibility.chance > p_unknown else None
    p_unknown = max(p_unknown, implausibility.chance)
    if best is not None and len(best.effects) > 1:
        top = max(scores.values())
        members = sorted((e.effect.name for e in best.effects), key=lambda n: -scores.get(n, -np.inf))
        scores |= {name: top + VERDICT.set_lead - i for i, name in enumerate(members)}
    top = max(scores.values())
    weights = {name: float(np.exp(score - top)) for name, score in scores.items()}
    total = sum(weights.values())
    probabilities = {name: weight / total * (1.0 - p_unknown) for name, weight in weights.items()}
    probabilities["unknown"] = p_unknown
    for name in _list_names(gap.config):
        probabilities.setdefault(name, 0.0)
    probabilities = _smooth_probabilities(probabilities)
    first = next(iter(probabilities))
    verdict: Verdict = "none" if first == "none" else "unknown" if first == "unknown" else "effect"
    why = reason if verdict == "unknown" else None
    return Judgement(verdict, probabilities, find_equivalent_effects(ranking), unexplained, best, why)


def reject_effect(judgement: Judgement) -> Judgement:
    """Change the verdict to `none`: it swaps its probability with the most probable effect."""
    probabilities, first = dict(judgement.probabilities), judgement.most_probable
    probabilities["none"], probabilities[first] = probabilities[first], probabilities["none"]
    ordered = dict(sorted(probabilities.items(), key=lambda row: -row[1]))
    return replace(judgement, verdict="none", probabilities=ordered, equivalent=())


def _smooth_probabilities(probabilities: Mapping[str, float]) -> dict[str, float]:
    """Limit every probability to about `VERDICT.max_probability`; the rest is spread evenly."""
    size, most = len(probabilities), VERDICT.max_probability
    mixed = {name: p * (most - 1.0 / size * most) + (1.0 - most) / size for name, p in probabilities.items()}
    total = sum(mixed.values())
    return dict(sorted(((n, p / total) for n, p in mixed.items()), key=lambda row: -row[1]))


def find_equivalent_effects(ranking: ModelRanking) -> tuple[tuple[str, ...], ...]:
    """The best effect with those of nearly the same evidence; twice as far behind for confusable ones."""
    if not ranking.found or ranking.found[0].log_evidence <= 0.0:
        return ()
    best, temperature = ranking.found[0], evidence_temperature(ranking)
    confusable, equivalent = find_confusable(best.name), [best.name]
    for hypothesis in ranking.found[1:]:
        behind = temperature * (best.log_evidence - hypothesis.log_evidence)
        factor = 2.0 if hypothesis.name in confusable else 1.0
        if hypothesis.name not in equivalent and behind < factor * VERDICT.equivalent_log_evidence:
            equivalent.append(hypothesis.name)
    return (tuple(equivalent),) if len(equivalent) > 1 else ()
