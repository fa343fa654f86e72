"""A second and a third effect, where one leaves too much.

How hypotheses stand to one another once priors are counted and laws are taken for what they are.

From evidence to probabilities, and from probabilities to a verdict.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.core.config import COMBINATIONS, VERDICT, DiagnoseConfig
from lagsplat.diagnose.core.result import Verdict
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.effects.registry import catalogue, find_confusable
from lagsplat.diagnose.inference.evidence import HypothesisFit, log_evidence
from lagsplat.diagnose.inference.model_selection import (
    ModelRanking,
    ProgressCallback,
    SearchBudget,
    rank_hypotheses,
)
from lagsplat.diagnose.inference.plausibility import Implausibility
from lagsplat.diagnose.inference.problem import EstimationProblem, excess_penalty


def combine_effects(
    problem: EstimationProblem,
    ranking: ModelRanking,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    config: DiagnoseConfig,
    *,
    report_progress: ProgressCallback,
) -> tuple[HypothesisFit, ...]:
    """The best single effect, the best pair and the best triple, while there is something left to explain.

    The second is looked for beside each of the best few first ones, so that the first may turn out to be
    another (swap). Empty where nothing beats `none`.
    """
    singles = effects_above_none(
        ranking, [name for name in catalogue() if name not in config.without], config
    )
    if not singles:
        return ()
    firsts = [one for one in singles if not isinstance(one.effects[-1].effect, SampleEffect)]
    narrow = replace(budget, families=max(3, budget.families // 2), places=1, starts=1, always_fitted=())
    chain = [singles[0]]
    while len(chain) < COMBINATIONS.max_effects and (
        excess_misfit(chain[-1], problem, budget.nominal) > COMBINATIONS.min_excess
        or exceeds_prior(chain[-1], budget.nominal, config)
    ):
        beside = firsts[: COMBINATIONS.max_first_effects] if len(chain) == 1 else chain[-1:]
        tried = []
        for held in beside:
            others = [o for o in candidates if o.effect.name not in {e.effect.name for e in held.effects}]
            more = rank_hypotheses(problem, others, narrow, known=held, report_progress=report_progress)
            found = [one for one in more.found if not isinstance(one.effects[-1].effect, SampleEffect)][:1]
            tried += [replace(one, log_evidence=held.log_evidence + one.log_evidence) for one in found]
        if not tried:
            break
        least = min(one.fit.misfit for one in tried) / problem.degrees_of_freedom
        noise_inflation = max(budget.nominal, least) * budget.effective_sample_ratio
        best = max(tried, key=lambda one: log_evidence(one, problem.rollout_model, noise_inflation))
        # of what stands above the noise, what the moved uncertainties cost included
        floor = budget.nominal * problem.degrees_of_freedom
        if best.fit.cost - floor > (1.0 - config.second_effect_share) * (chain[-1].fit.cost - floor):
            break
        chain.append(best)
    return tuple(chain)


def excess_misfit(one: HypothesisFit, problem: EstimationProblem, nominal: float) -> float:
    """Mean square residual of a fit above what the sim leaves of its own recordings."""
    return one.fit.misfit / problem.degrees_of_freedom - nominal


def evidence_temperature(ranking: ModelRanking) -> float:
    """What a nat is worth: the laws of the catalogue are never quite those of nature.

    Where thousands of nats stand between `none` and the best, a per cent of them between two effects may be
    the fault of a law, so that no more than `VERDICT.max_log_evidence` nats count in all.
    """
    most = max((one.log_evidence for one in ranking.found), default=0.0)
    return 1.0 / (1.0 + max(most, 0.0) / VERDICT.max_log_evidence)


def log_posteriors(ranking: ModelRanking, names: list[str], config: DiagnoseConfig) -> dict[str, float]:
    """Log posterior, up to a constant, of `none` and of every effect that was fitted, at its best place.

    Each of the ``names`` of the catalogue is as likely beforehand, whatever the number of its places.
    """
    prior = np.log((1.0 - config.prior_none - config.prior_unknown) / len(names))
    scores = {"none": float(np.log(config.prior_none))}
    places: dict[str, int] = {}
    worth = evidence_temperature(ranking)
    for one in ranking.found:
        name = one.effects[-1].effect.name
        places[name] = places.get(name, 0) + 1
        rare = _log_prior_penalty(one)
        scores.setdefault(name, float(prior) + worth * one.log_evidence - rare)
    for name, n in places.items():
        scores[name] -= float(np.log(n))
    return scores


def _log_prior_penalty(fit: HypothesisFit) -> float:
    """By how much the effect of a hypothesis is less likely than others, before the data [nat]."""
    placed = fit.effects[-1]
    effect = placed.effect
    if effect.fitted_penalty is None:
        return effect.log_prior_penalty
    parameters = placed.name_parameters(fit.fit.x[fit.parameter_slice(placed)])
    return effect.log_prior_penalty + effect.fitted_penalty(parameters, placed)


def effects_above_none(
    ranking: ModelRanking, names: list[str], config: DiagnoseConfig
) -> list[HypothesisFit]:
    """The best fit of every effect that stands above `none`, the best first."""
    scores = log_posteriors(ranking, names, config)
    best: dict[str, HypothesisFit] = {}
    for one in ranking.found:
        best.setdefault(one.effects[-1].effect.name, one)
    above = [name for name in best if scores[name] > scores["none"]]
    return [best[name] for name in sorted(above, key=lambda name: -scores[name])]


@dataclass(frozen=True)
class Judgement:
    """Probabilities of all names, the names of the most probable explanation, and the verdict."""

    verdict: Verdict
    probabilities: Mapping[str, float]
    equivalent: tuple[tuple[str, ...], ...]
    left: float
    """Share of the excess misfit that the best explanation leaves."""
    best: HypothesisFit | None
    """The best explanation, whether or not the verdict names it."""
    doubted: str | None = None
    """Why it is not believed although it explains the gap."""


def choose_explanation(
    chain: Sequence[HypothesisFit], before: float, freedom: float, nominal: float, config: DiagnoseConfig
) -> tuple[HypothesisFit | None, float, float]:
    """The single effect or the set that explains the gap, the share of it that it leaves, and P(unknown).

    ``before`` is the excess without effects. A set is believed only if it leaves next to nothing, for two
    wrong effects imitate most of anything, and three all the more. Otherwise the best single effect stands,
    and the more it leaves, the likelier is something that the catalogue lacks: logistic in the logarithm of
    that share over ``config.unknown_midpoint``. What is `unexplained_misfit` counts where it is `detectable_misfit`.
    """
    if not chain:
        return None, 1.0, _unknown_probability(before, before, freedom, nominal, config)
    left = [unexplained_misfit(one, freedom, nominal, config) for one in chain]
    share = [max(rest, 0.0) / max(before, rest, 1e-9) for rest in left]
    if share[0] > config.sufficient_share or exceeds_prior(chain[0], nominal, config):
        for one, rest, part in zip(chain[1:], left[1:], share[1:], strict=True):
            enough = (rest < detectable_misfit(freedom, nominal, config), part < config.sufficient_share)
            if all(enough) if len(one.effects) > 2 else any(enough):
                return one, part, VERDICT.min_unknown
    return chain[0], share[0], _unknown_probability(left[0], before, freedom, nominal, config)


def motionless_misfit(problem: EstimationProblem) -> float:
    """Mean square of the motion about its middle [noise]: what a sim that stood still would miss."""
    data = problem.data
    middle = np.average(data.y, axis=(0, 1), weights=data.weight > 0.0)
    return float((((data.y - middle) * data.weight) ** 2).sum()) / problem.degrees_of_freedom


def unexplained_misfit(one: HypothesisFit, freedom: float, nominal: float, config: DiagnoseConfig) -> float:
    """Mean square that an explanation leaves above what the sim does of its own recordings [noise].

    What it has pushed into the sim's own uncertainties, beyond what is believed of these, is left, too.
    """
    return (
        one.fit.misfit + excess_penalty(one.fit, nominal * config.effective_sample_ratio)
    ) / freedom - nominal


def exceeds_prior(one: HypothesisFit, nominal: float, config: DiagnoseConfig) -> bool:
    """Whether the sim's own uncertainties had to move further than they are believed to."""
    return excess_penalty(one.fit, nominal * config.effective_sample_ratio) > 0.0


def detectable_misfit(freedom: float, nominal: float, config: DiagnoseConfig) -> float:
    """Excess of a mean square residual that stands out of its scatter, and of what laws are wrong by."""
    return float(
        VERDICT.law_error * nominal
        + 2.5 * nominal * np.sqrt(2.0 * config.effective_sample_ratio / max(freedom, 1.0))
    )


def _unknown_probability(
    left: float, before: float, freedom: float, nominal: float, config: DiagnoseConfig
) -> float:
    loud = left - detectable_misfit(freedom, nominal, config)
    if loud <= 0.0:
        return VERDICT.min_unknown
    share = min(loud / max(before, loud), 1.0)
    return max(
        float(1.0 / (1.0 + (config.unknown_midpoint / share) ** VERDICT.unknown_exponent)),
        VERDICT.min_unknown,
    )


def judge_hypotheses(
    ranking: ModelRanking,
    chain: Sequence[HypothesisFit],
    freedom: float,
    nominal: float,
    config: DiagnoseConfig,
    *,
    most: float = np.inf,
    doubt: Callable[[HypothesisFit], Implausibility] = lambda one: Implausibility(0.0, "loose"),
) -> Judgement:
    """Probabilities by evidence and prior; the share that is left unexplained speaks for `unknown`.

    So does ``doubt``, the doubt in an explanation if it is the best. A sim that runs off misses no more than
    one that stands still, ``most`` (`motionless_misfit`): nearly anything would explain the most part of a larger gap.
    """
    names = [name for name in catalogue() if name not in config.without]
    scores = log_posteriors(ranking, names, config)
    before = min(unexplained_misfit(ranking.none, freedom, nominal, config), most)
    best, left, strange = choose_explanation(chain, before, freedom, nominal, config)
    doubted = doubt(best or ranking.none)
    told = doubted.why if doubted.chance > strange else None
    strange = max(strange, doubted.chance)
    if best is not None and len(best.effects) > 1:
        top = max(scores.values())
        own = sorted((e.effect.name for e in best.effects), key=lambda n: -scores.get(n, -np.inf))
        scores |= {name: top + VERDICT.set_lead - i for i, name in enumerate(own)}
    top = max(scores.values())
    weights = {name: float(np.exp(score - top)) for name, score in scores.items()}
    total = sum(weights.values())
    probabilities = {name: weight / total * (1.0 - strange) for name, weight in weights.items()}
    probabilities["unknown"] = strange
    for name in names:
        probabilities.setdefault(name, 0.0)
    probabilities = _smooth_probabilities(probabilities)
    verdict = _most_probable_verdict(probabilities)
    why = told if verdict == "unknown" else None
    return Judgement(verdict, probabilities, find_equivalent_effects(ranking), left, best, why)


def reject_effect(judgement: Judgement) -> Judgement:
    """The verdict `none` after all: it changes places with the most probable effect."""
    probabilities = dict(judgement.probabilities)
    first = next(iter(probabilities))
    probabilities["none"], probabilities[first] = probabilities[first], probabilities["none"]
    ordered = dict(sorted(probabilities.items(), key=lambda row: -row[1]))
    return replace(judgement, verdict="none", probabilities=ordered, equivalent=())


def _smooth_probabilities(probabilities: Mapping[str, float]) -> dict[str, float]:
    """No name gets more than `VERDICT.max_probability`; what is cut off is spread over the rest."""
    size = len(probabilities)
    mixed = {
        name: p * (VERDICT.max_probability - 1.0 / size * VERDICT.max_probability)
        + (1.0 - VERDICT.max_probability) / size
        for name, p in probabilities.items()
    }
    total = sum(mixed.values())
    return dict(sorted(((n, p / total) for n, p in mixed.items()), key=lambda row: -row[1]))


def _most_probable_verdict(probabilities: Mapping[str, float]) -> Verdict:
    first = next(iter(probabilities))
    if first in ("none", "unknown"):
        return first  # type: ignore[return-value]
    return "effect"


def find_equivalent_effects(ranking: ModelRanking) -> tuple[tuple[str, ...], ...]:
    """The best effect with those that are as evident: of its class, or within the same nats."""
    if not ranking.found or ranking.found[0].log_evidence <= 0.0:
        return ()
    best = ranking.found[0]
    name = best.effects[-1].effect.name
    kin = find_confusable(name)
    near: list[str] = [name]
    strength = evidence_temperature(ranking)
    for one in ranking.found[1:]:
        other = one.effects[-1].effect.name
        behind = strength * (best.log_evidence - one.log_evidence)
        if other not in near and behind < (
            VERDICT.equivalent_log_evidence if other not in kin else 2.0 * VERDICT.equivalent_log_evidence
        ):
            near.append(other)
    return (tuple(near),) if len(near) > 1 else ()


def laplace_interval(
    one: HypothesisFit, bench_deviation: np.ndarray, prior: Sequence, noise_inflation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns of the effects at both ends of their 90 % intervals, by Laplace's approximation."""
    n = one.n_effect_parameters
    deviation = np.concatenate([[p.deviation for p in prior], bench_deviation])
    h = one.fit.curvature / noise_inflation + np.diag(1.0 / deviation**2)
    spread = (
        VERDICT.deviation_factor * np.sqrt(np.maximum(np.diag(np.linalg.pinv(h))[:n], 0.0))
        + VERDICT.deviation_floor
    )
    lowest = np.array([p.lowest for p in prior])
    return np.maximum(one.fit.x[:n] - 1.645 * spread, lowest), one.fit.x[:n] + 1.645 * spread
