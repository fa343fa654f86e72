"""A second and a third effect, where one leaves too much.

How hypotheses stand to one another once priors are counted and laws are taken for what they are.

From evidence to probabilities, and from probabilities to a verdict.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.core.result import Verdict
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.inference.evidence import HypothesisFit, log_evidence
from lagsplat.diagnose.inference.model_selection import (
    ModelRanking,
    ProgressCallback,
    SearchBudget,
    rank_hypotheses,
)
from lagsplat.diagnose.inference.plausibility import Implausibility
from lagsplat.diagnose.inference.problem import EstimationProblem, excess_penalty

MOST = 3
FIRST = 3
"""Single effects that a second one is looked for beside."""
ENOUGH = 0.1
"""Excess of the mean square residual, in units of the noise, that is not worth explaining."""


def combine_effects(
    contest: EstimationProblem,
    ranking: ModelRanking,
    offers: Sequence[PlacedEffect],
    effort: SearchBudget,
    config: DiagnoseConfig,
    *,
    tell: ProgressCallback,
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
    narrow = replace(effort, families=max(3, effort.families // 2), places=1, starts=1, always=())
    chain = [singles[0]]
    while len(chain) < MOST and (
        excess_misfit(chain[-1], contest, effort.nominal) > ENOUGH
        or exceeds_prior(chain[-1], effort.nominal, config)
    ):
        beside = firsts[:FIRST] if len(chain) == 1 else chain[-1:]
        tried = []
        for held in beside:
            others = [o for o in offers if o.effect.name not in {e.effect.name for e in held.effects}]
            more = rank_hypotheses(contest, others, narrow, known=held, tell=tell)
            found = [one for one in more.found if not isinstance(one.effects[-1].effect, SampleEffect)][:1]
            tried += [replace(one, log_evidence=held.log_evidence + one.log_evidence) for one in found]
        if not tried:
            break
        least = min(one.fit.misfit for one in tried) / contest.uncertainty_directions
        temper = max(effort.nominal, least) * effort.temper
        best = max(tried, key=lambda one: log_evidence(one, contest.rollout_model, temper))
        # of what stands above the noise, what the moved uncertainties cost included
        floor = effort.nominal * contest.uncertainty_directions
        if best.fit.cost - floor > (1.0 - config.further) * (chain[-1].fit.cost - floor):
            break
        chain.append(best)
    return tuple(chain)


def excess_misfit(one: HypothesisFit, contest: EstimationProblem, nominal: float) -> float:
    """Mean square residual of a fit above what the sim leaves of its own recordings."""
    return one.fit.misfit / contest.uncertainty_directions - nominal


ROUGHLY = 200.0
RARER = {
    "camera_change": 4.0,
    "external_push": 3.0,
    "hidden_mode": 3.0,
    "stribeck_friction": 2.0,
    "load_dependent_friction": 2.0,
}
"""Nats by which a flexible effect is held less likely beforehand, for it imitates many others."""
SLOW, A_SPRING = 0.5, 4.0
"""Share of the recording from which creep takes so long that it is but a spring, and nats that this costs."""


def evidence_temperature(ranking: ModelRanking) -> float:
    """What a nat is worth: the laws of the catalogue are never quite those of nature.

    Where thousands of nats stand between `none` and the best, a per cent of them between two effects may be
    the fault of a law, so that no more than `ROUGHLY` nats count in all.
    """
    most = max((one.log_evidence for one in ranking.found), default=0.0)
    return 1.0 / (1.0 + max(most, 0.0) / ROUGHLY)


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
        rare = RARER.get(name, 0.0) + (A_SPRING if name == "creep" and _is_nearly_elastic(one) else 0.0)
        scores.setdefault(name, float(prior) + worth * one.log_evidence - rare)
    for name, n in places.items():
        scores[name] -= float(np.log(n))
    return scores


def _is_nearly_elastic(one: HypothesisFit) -> bool:
    """Whether its time constant is about as long as the recording: nobody saw it come to rest."""
    instance = one.effects[-1]
    own = instance.physical(one.fit.x[None, one.own(instance)])[0]
    keys = [p.name for p in instance.effect.parameters]
    return bool(own[keys.index("time_constant")] > SLOW * instance.scales.duration_s)


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


CLASSES = (
    ("input_delay", "time_offset", "input_lag"),
    ("mass_change", "linear_stiffness", "input_gain", "viscous_damping"),
    ("camera_change", "input_gain", "constant_force"),
    ("coulomb_friction", "stribeck_friction", "load_dependent_friction", "hysteresis"),
    ("creep", "viscous_damping", "linear_stiffness", "parameter_drift"),
    ("end_stop", "cubic_stiffness"),
    ("external_periodic_force", "hidden_mode"),
    ("quadratic_drag", "viscous_damping"),
    ("input_dead_zone", "input_backlash", "coulomb_friction"),
    ("input_saturation", "input_gain"),
    ("hidden_mode", "mass_change"),
    ("parameter_drift", "camera_drift"),
)
"""Effects that some recordings cannot tell apart."""
NEAR = 3.0
"""Nats within which two members of one class count as not told apart."""
SURE = 0.98
WRONG_BY = 0.03
"""Share of the mean square residual by which a right law may be wrong."""
LEAST_UNKNOWN = 0.015
STEEP = 2.5
"""Power of the share left unexplained in the odds of `unknown`."""
WIDER, ROUGH = 1.5, 0.01
"""Factor on a parameter's standard deviation, and what is added: laws are never quite right."""
CERTAIN = 5.0
"""Nats by which the members of a set that explains everything stand above any single effect."""


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
    that share over ``config.unexplained``. What is `unexplained_misfit` counts where it is `detectable_misfit`.
    """
    if not chain:
        return None, 1.0, _unknown_probability(before, before, freedom, nominal, config)
    left = [unexplained_misfit(one, freedom, nominal, config) for one in chain]
    share = [max(rest, 0.0) / max(before, rest, 1e-9) for rest in left]
    if share[0] > config.further_from or exceeds_prior(chain[0], nominal, config):
        for one, rest, part in zip(chain[1:], left[1:], share[1:], strict=True):
            enough = (rest < detectable_misfit(freedom, nominal, config), part < config.further_from)
            if all(enough) if len(one.effects) > 2 else any(enough):
                return one, part, LEAST_UNKNOWN
    return chain[0], share[0], _unknown_probability(left[0], before, freedom, nominal, config)


def motionless_misfit(contest: EstimationProblem) -> float:
    """Mean square of the motion about its middle [noise]: what a sim that stood still would miss."""
    data = contest.data
    middle = np.average(data.y, axis=(0, 1), weights=data.weight > 0.0)
    return float((((data.y - middle) * data.weight) ** 2).sum()) / contest.uncertainty_directions


def unexplained_misfit(one: HypothesisFit, freedom: float, nominal: float, config: DiagnoseConfig) -> float:
    """Mean square that an explanation leaves above what the sim does of its own recordings [noise].

    What it has pushed into the sim's own uncertainties, beyond what is believed of these, is left, too.
    """
    return (one.fit.misfit + excess_penalty(one.fit, nominal * config.temper)) / freedom - nominal


def exceeds_prior(one: HypothesisFit, nominal: float, config: DiagnoseConfig) -> bool:
    """Whether the sim's own uncertainties had to move further than they are believed to."""
    return excess_penalty(one.fit, nominal * config.temper) > 0.0


def detectable_misfit(freedom: float, nominal: float, config: DiagnoseConfig) -> float:
    """Excess of a mean square residual that stands out of its scatter, and of what laws are wrong by."""
    return float(WRONG_BY * nominal + 2.5 * nominal * np.sqrt(2.0 * config.temper / max(freedom, 1.0)))


def _unknown_probability(
    left: float, before: float, freedom: float, nominal: float, config: DiagnoseConfig
) -> float:
    loud = left - detectable_misfit(freedom, nominal, config)
    if loud <= 0.0:
        return LEAST_UNKNOWN
    share = min(loud / max(before, loud), 1.0)
    return max(float(1.0 / (1.0 + (config.unexplained / share) ** STEEP)), LEAST_UNKNOWN)


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
        scores |= {name: top + CERTAIN - i for i, name in enumerate(own)}
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
    """No name gets more than `SURE`; what is cut off is spread over the rest."""
    size = len(probabilities)
    mixed = {name: p * (SURE - 1.0 / size * SURE) + (1.0 - SURE) / size for name, p in probabilities.items()}
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
    kin = {other for group in CLASSES if name in group for other in group}
    near: list[str] = [name]
    strength = evidence_temperature(ranking)
    for one in ranking.found[1:]:
        other = one.effects[-1].effect.name
        behind = strength * (best.log_evidence - one.log_evidence)
        if other not in near and behind < (NEAR if other not in kin else 2.0 * NEAR):
            near.append(other)
    return (tuple(near),) if len(near) > 1 else ()


def laplace_interval(
    one: HypothesisFit, bench_deviation: np.ndarray, prior: Sequence, temper: float
) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns of the effects at both ends of their 90 % intervals, by Laplace's approximation."""
    n = one.n_own
    deviation = np.concatenate([[p.deviation for p in prior], bench_deviation])
    h = one.fit.curvature / temper + np.diag(1.0 / deviation**2)
    spread = WIDER * np.sqrt(np.maximum(np.diag(np.linalg.pinv(h))[:n], 0.0)) + ROUGH
    lowest = np.array([p.lowest for p in prior])
    return np.maximum(one.fit.x[:n] - 1.645 * spread, lowest), one.fit.x[:n] + 1.645 * spread
