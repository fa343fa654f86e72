"""From log evidence to probabilities and a verdict; sets of several effects."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.core.config import COMBINATIONS, VERDICT, DiagnoseConfig
from lagsplat.diagnose.core.result import Verdict
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.effects.registry import catalogue, find_confusable
from lagsplat.diagnose.inference.model_selection import (
    ModelRanking,
    ProgressCallback,
    SearchBudget,
    rank_hypotheses,
)
from lagsplat.diagnose.inference.plausibility import Implausibility
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    HypothesisFit,
    compute_excess_penalty,
    compute_log_evidence,
)


def combine_effects(
    problem: EstimationProblem,
    ranking: ModelRanking,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    config: DiagnoseConfig,
    *,
    report_progress: ProgressCallback,
) -> tuple[HypothesisFit, ...]:
    """The best single effect, pair and triple, as long as a larger set explains enough more.

    A second effect is sought beside each of the best few single effects, so that the pair may hold another
    first effect than the best single one. Empty where nothing beats `none`.

    Args:
        problem: data, sim and noise.
        ranking: fits of the single effects.
        candidates: effects at their places.
        budget: search budget of the single effects; half of the families are fitted here.
        config: settings of the diagnosis.
        report_progress: called with the name of each effect before it is fitted.
    """
    singles = select_probable_effects(
        ranking, [name for name in catalogue() if name not in config.without], config
    )
    if not singles:
        return ()
    firsts = _without_sample_effects(singles)
    narrow = replace(budget, families=max(3, budget.families // 2), places=1, starts=1, always_fitted=())
    chain = [singles[0]]
    while len(chain) < COMBINATIONS.max_effects and (
        compute_excess_misfit(chain[-1], problem, budget.nominal) > COMBINATIONS.min_excess
        or exceeds_prior(chain[-1], budget.nominal, config)
    ):
        beside = firsts[: COMBINATIONS.max_first_effects] if len(chain) == 1 else chain[-1:]
        larger = []
        for known in beside:
            names = {placed.effect.name for placed in known.effects}
            others = [candidate for candidate in candidates if candidate.effect.name not in names]
            more = rank_hypotheses(problem, others, narrow, known=known, report_progress=report_progress)
            for fit in _without_sample_effects(more.found)[:1]:
                larger.append(replace(fit, log_evidence=known.log_evidence + fit.log_evidence))
        if not larger:
            break
        least = min(fit.fit.misfit for fit in larger) / problem.degrees_of_freedom
        noise_inflation = max(budget.nominal, least) * budget.effective_sample_ratio
        best = max(larger, key=lambda fit: compute_log_evidence(fit, problem.rollout_model, noise_inflation))
        # the share above the noise floor; the cost includes the penalty of the nuisance parameters
        floor = budget.nominal * problem.degrees_of_freedom
        if best.fit.cost - floor > (1.0 - config.second_effect_share) * (chain[-1].fit.cost - floor):
            break
        chain.append(best)
    return tuple(chain)


def _without_sample_effects(fits: Sequence[HypothesisFit]) -> list[HypothesisFit]:
    """The fits whose last effect is none on single samples."""
    return [fit for fit in fits if not isinstance(fit.effects[-1].effect, SampleEffect)]


def compute_excess_misfit(hypothesis: HypothesisFit, problem: EstimationProblem, nominal: float) -> float:
    """Mean square residual of a fit above the nominal one [noise variances]."""
    return hypothesis.fit.misfit / problem.degrees_of_freedom - nominal


def evidence_temperature(ranking: ModelRanking) -> float:
    """Factor in (0, 1] on every log evidence, because the laws of the catalogue are approximate.

    Where the best effect gains thousands of nats, an error of one per cent in its law moves tens of nats.
    With this factor no log evidence counts more than `VERDICT.max_log_evidence`.
    """
    most = max((hypothesis.log_evidence for hypothesis in ranking.found), default=0.0)
    return 1.0 / (1.0 + max(most, 0.0) / VERDICT.max_log_evidence)


def log_posteriors(ranking: ModelRanking, names: list[str], config: DiagnoseConfig) -> dict[str, float]:
    """Log posterior, up to a constant, of `none` and of every fitted effect at its best place [nat].

    All ``names`` of the catalogue have the same prior probability, whatever the number of their places, less
    the penalty that an effect may have.
    """
    prior = np.log((1.0 - config.prior_none - config.prior_unknown) / len(names))
    scores = {"none": float(np.log(config.prior_none))}
    places: dict[str, int] = {}
    worth = evidence_temperature(ranking)
    for hypothesis in ranking.found:
        name = hypothesis.name
        places[name] = places.get(name, 0) + 1
        rare = _log_prior_penalty(hypothesis)
        scores.setdefault(name, float(prior) + worth * hypothesis.log_evidence - rare)
    for name, n in places.items():
        scores[name] -= float(np.log(n))
    return scores


def _log_prior_penalty(fit: HypothesisFit) -> float:
    """Reduction of the log prior of a hypothesis' effect [nat]."""
    placed = fit.effects[-1]
    effect = placed.effect
    if effect.fitted_penalty is None:
        return effect.log_prior_penalty
    parameters = placed.name_parameters(fit.fit.x[fit.parameter_slice(placed)])
    return effect.log_prior_penalty + effect.fitted_penalty(parameters, placed)


def select_probable_effects(
    ranking: ModelRanking, names: list[str], config: DiagnoseConfig
) -> list[HypothesisFit]:
    """The best fit of every effect that is more probable than `none`, the most probable first."""
    scores = log_posteriors(ranking, names, config)
    best: dict[str, HypothesisFit] = {}
    for hypothesis in ranking.found:
        best.setdefault(hypothesis.name, hypothesis)
    above = [name for name in best if scores[name] > scores["none"]]
    return [best[name] for name in sorted(above, key=lambda name: -scores[name])]


@dataclass(frozen=True)
class Judgement:
    """Probabilities of all names, the best explanation, and the verdict."""

    verdict: Verdict
    probabilities: Mapping[str, float]
    equivalent: tuple[tuple[str, ...], ...]
    unexplained: float  # share of the excess misfit that the best explanation leaves
    best: HypothesisFit | None  # the best explanation, whether or not the verdict names it
    implausibility: str | None = None
    """The reason against it, where the verdict is `unknown` although it explains the gap."""


def choose_explanation(
    chain: Sequence[HypothesisFit], before: float, freedom: float, nominal: float, config: DiagnoseConfig
) -> tuple[HypothesisFit | None, float, float]:
    """The effect or set that explains the gap, the share of the gap that it leaves, and P(unknown).

    Two wrong effects imitate nearly anything, and three even more. So a set is chosen only if it leaves less
    than `compute_detectable_misfit` or ``config.sufficient_share``, and both for three effects. Otherwise the
    best single effect is chosen, and P(unknown) is logistic in the logarithm of the share that it leaves.

    Args:
        chain: the best single effect, pair and triple.
        before: `compute_unexplained_misfit` without effects.
        freedom: degrees of freedom of the residual.
        nominal: mean square residual of the sim on its own recordings [noise variances].
        config: settings of the diagnosis.
    """
    if not chain:
        return None, 1.0, _unknown_probability(before, before, freedom, nominal, config)
    unexplained = [compute_unexplained_misfit(hypothesis, freedom, nominal, config) for hypothesis in chain]
    share = [max(rest, 0.0) / max(before, rest, 1e-9) for rest in unexplained]
    if share[0] > config.sufficient_share or exceeds_prior(chain[0], nominal, config):
        for hypothesis, rest, part in zip(chain[1:], unexplained[1:], share[1:], strict=True):
            enough = (
                rest < compute_detectable_misfit(freedom, nominal, config),
                part < config.sufficient_share,
            )
            if all(enough) if len(hypothesis.effects) > 2 else any(enough):
                return hypothesis, part, VERDICT.min_unknown
    return chain[0], share[0], _unknown_probability(unexplained[0], before, freedom, nominal, config)


def compute_motionless_misfit(problem: EstimationProblem) -> float:
    """Mean square of the motion about its mean [noise variances]: the misfit of a sim that does not move."""
    data = problem.data
    middle = np.average(data.y, axis=(0, 1), weights=data.weight > 0.0)
    return float((((data.y - middle) * data.weight) ** 2).sum()) / problem.degrees_of_freedom


def compute_unexplained_misfit(
    hypothesis: HypothesisFit, freedom: float, nominal: float, config: DiagnoseConfig
) -> float:
    """Mean square that an explanation leaves above the nominal one [noise variances].

    Nuisance parameters that moved further than their prior allows count as unexplained.
    """
    return (
        hypothesis.fit.misfit
        + compute_excess_penalty(hypothesis.fit, nominal * config.effective_sample_ratio)
    ) / freedom - nominal


def exceeds_prior(hypothesis: HypothesisFit, nominal: float, config: DiagnoseConfig) -> bool:
    """Whether the nuisance parameters moved further than their prior allows."""
    return compute_excess_penalty(hypothesis.fit, nominal * config.effective_sample_ratio) > 0.0


def compute_detectable_misfit(freedom: float, nominal: float, config: DiagnoseConfig) -> float:
    """Excess mean square residual that is detectable [noise variances].

    The errors of a right law, plus `VERDICT.detectable_deviations` standard deviations of a mean square with
    correlated samples.
    """
    return float(
        VERDICT.law_error * nominal
        + VERDICT.detectable_deviations
        * nominal
        * np.sqrt(2.0 * config.effective_sample_ratio / max(freedom, 1.0))
    )


def _unknown_probability(
    unexplained: float, before: float, freedom: float, nominal: float, config: DiagnoseConfig
) -> float:
    detectable = unexplained - compute_detectable_misfit(freedom, nominal, config)
    if detectable <= 0.0:
        return VERDICT.min_unknown
    share = min(detectable / max(before, detectable), 1.0)
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
    doubt: Callable[[HypothesisFit], Implausibility] = lambda hypothesis: Implausibility(0.0, "loose"),
) -> Judgement:
    """Probabilities of all names by evidence and prior, and the verdict.

    P(unknown) grows with the share that the best explanation leaves, and is at least its implausibility.

    Args: ranking: fits of the single effects. chain: the best single effect, pair and triple. freedom:
        degrees of freedom of the residual. nominal: mean square residual of the sim on its own recordings
        [noise variances]. config: settings of the diagnosis. most: largest gap that counts,
        `compute_motionless_misfit`; nearly anything explains most of a diverged rollout.
        doubt: implausibility of an explanation.
    """
    names = [name for name in catalogue() if name not in config.without]
    scores = log_posteriors(ranking, names, config)
    before = min(compute_unexplained_misfit(ranking.none, freedom, nominal, config), most)
    best, unexplained, p_unknown = choose_explanation(chain, before, freedom, nominal, config)
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
    for name in names:
        probabilities.setdefault(name, 0.0)
    probabilities = _smooth_probabilities(probabilities)
    verdict = _most_probable_verdict(probabilities)
    why = reason if verdict == "unknown" else None
    return Judgement(verdict, probabilities, find_equivalent_effects(ranking), unexplained, best, why)


def reject_effect(judgement: Judgement) -> Judgement:
    """Change the verdict to `none`: it swaps its probability with the most probable effect."""
    probabilities = dict(judgement.probabilities)
    first = next(iter(probabilities))
    probabilities["none"], probabilities[first] = probabilities[first], probabilities["none"]
    ordered = dict(sorted(probabilities.items(), key=lambda row: -row[1]))
    return replace(judgement, verdict="none", probabilities=ordered, equivalent=())


def _smooth_probabilities(probabilities: Mapping[str, float]) -> dict[str, float]:
    """Limit every probability to about `VERDICT.max_probability`; the rest is spread evenly."""
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
    """The best effect with those of nearly the same evidence; the limit is twice as wide for confusable
    ones."""
    if not ranking.found or ranking.found[0].log_evidence <= 0.0:
        return ()
    best = ranking.found[0]
    name = best.effects[-1].effect.name
    confusable = find_confusable(name)
    equivalent: list[str] = [name]
    temperature = evidence_temperature(ranking)
    for hypothesis in ranking.found[1:]:
        other = hypothesis.name
        behind = temperature * (best.log_evidence - hypothesis.log_evidence)
        if other not in equivalent and behind < (
            VERDICT.equivalent_log_evidence
            if other not in confusable
            else 2.0 * VERDICT.equivalent_log_evidence
        ):
            equivalent.append(other)
    return (tuple(equivalent),) if len(equivalent) > 1 else ()


def compute_laplace_interval(
    hypothesis: HypothesisFit, bench_deviation: np.ndarray, prior: Sequence, noise_inflation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters of the effects at both ends of their 90 % intervals, by Laplace's approximation."""
    n = hypothesis.n_effect_parameters
    deviation = np.concatenate([[p.deviation for p in prior], bench_deviation])
    h = hypothesis.fit.curvature / noise_inflation + np.diag(1.0 / deviation**2)
    spread = (
        VERDICT.deviation_factor * np.sqrt(np.maximum(np.diag(np.linalg.pinv(h))[:n], 0.0))
        + VERDICT.deviation_floor
    )
    lowest = np.array([p.lowest for p in prior])
    return np.maximum(hypothesis.fit.x[:n] - VERDICT.interval_z * spread, lowest), hypothesis.fit.x[
        :n
    ] + VERDICT.interval_z * spread
