"""From evidence to probabilities, and from probabilities to a verdict."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.catalogue import catalogue
from lagsplat.diagnose.compare import Contest, Explained, pushed
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.doubt import Doubt
from lagsplat.diagnose.result import Verdict
from lagsplat.diagnose.select import Ranking
from lagsplat.diagnose.standing import standings, trust

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
    best: Explained | None
    """The best explanation, whether or not the verdict names it."""
    doubted: str | None = None
    """Why it is not believed although it explains the gap."""


def explain(
    chain: Sequence[Explained], before: float, freedom: float, nominal: float, config: DiagnoseConfig
) -> tuple[Explained | None, float, float]:
    """The single effect or the set that explains the gap, the share of it that it leaves, and P(unknown).

    ``before`` is the excess without effects. A set is believed only if it leaves next to nothing, for two
    wrong effects imitate most of anything, and three all the more. Otherwise the best single effect stands,
    and the more it leaves, the likelier is something that the catalogue lacks: logistic in the logarithm of
    that share over ``config.unexplained``. What is `left_over` counts where it is `audible`.
    """
    if not chain:
        return None, 1.0, _strange(before, before, freedom, nominal, config)
    left = [left_over(one, freedom, nominal, config) for one in chain]
    share = [max(rest, 0.0) / max(before, rest, 1e-9) for rest in left]
    if share[0] > config.further_from or moved(chain[0], nominal, config):
        for one, rest, part in zip(chain[1:], left[1:], share[1:], strict=True):
            enough = (rest < audible(freedom, nominal, config), part < config.further_from)
            if all(enough) if len(one.effects) > 2 else any(enough):
                return one, part, LEAST_UNKNOWN
    return chain[0], share[0], _strange(left[0], before, freedom, nominal, config)


def swing(contest: Contest) -> float:
    """Mean square of the motion about its middle [noise]: what a sim that stood still would miss."""
    data = contest.data
    middle = np.average(data.y, axis=(0, 1), weights=data.weight > 0.0)
    return float((((data.y - middle) * data.weight) ** 2).sum()) / contest.freedom


def left_over(one: Explained, freedom: float, nominal: float, config: DiagnoseConfig) -> float:
    """Mean square that an explanation leaves above what the sim does of its own recordings [noise].

    What it has pushed into the sim's own uncertainties, beyond what is believed of these, is left, too.
    """
    return (one.fit.misfit + pushed(one.fit, nominal * config.temper)) / freedom - nominal


def moved(one: Explained, nominal: float, config: DiagnoseConfig) -> bool:
    """Whether the sim's own uncertainties had to move further than they are believed to."""
    return pushed(one.fit, nominal * config.temper) > 0.0


def audible(freedom: float, nominal: float, config: DiagnoseConfig) -> float:
    """Excess of a mean square residual that stands out of its scatter, and of what laws are wrong by."""
    return float(WRONG_BY * nominal + 2.5 * nominal * np.sqrt(2.0 * config.temper / max(freedom, 1.0)))


def _strange(left: float, before: float, freedom: float, nominal: float, config: DiagnoseConfig) -> float:
    loud = left - audible(freedom, nominal, config)
    if loud <= 0.0:
        return LEAST_UNKNOWN
    share = min(loud / max(before, loud), 1.0)
    return max(float(1.0 / (1.0 + (config.unexplained / share) ** STEEP)), LEAST_UNKNOWN)


def judge(
    ranking: Ranking,
    chain: Sequence[Explained],
    freedom: float,
    nominal: float,
    config: DiagnoseConfig,
    *,
    most: float = np.inf,
    doubt: Callable[[Explained], Doubt] = lambda one: Doubt(0.0, "loose"),
) -> Judgement:
    """Probabilities by evidence and prior; the share that is left unexplained speaks for `unknown`.

    So does ``doubt``, the doubt in an explanation if it is the best. A sim that runs off misses no more than
    one that stands still, ``most`` (`swing`): nearly anything would explain the most part of a larger gap.
    """
    names = [name for name in catalogue() if name not in config.without]
    scores = standings(ranking, names, config)
    before = min(left_over(ranking.none, freedom, nominal, config), most)
    best, left, strange = explain(chain, before, freedom, nominal, config)
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
    probabilities = _tempered(probabilities)
    verdict = _verdict(probabilities)
    why = told if verdict == "unknown" else None
    return Judgement(verdict, probabilities, equivalents(ranking), left, best, why)


def denied(judgement: Judgement) -> Judgement:
    """The verdict `none` after all: it changes places with the most probable effect."""
    probabilities = dict(judgement.probabilities)
    first = next(iter(probabilities))
    probabilities["none"], probabilities[first] = probabilities[first], probabilities["none"]
    ordered = dict(sorted(probabilities.items(), key=lambda row: -row[1]))
    return replace(judgement, verdict="none", probabilities=ordered, equivalent=())


def _tempered(probabilities: Mapping[str, float]) -> dict[str, float]:
    """No name gets more than `SURE`; what is cut off is spread over the rest."""
    size = len(probabilities)
    mixed = {name: p * (SURE - 1.0 / size * SURE) + (1.0 - SURE) / size for name, p in probabilities.items()}
    total = sum(mixed.values())
    return dict(sorted(((n, p / total) for n, p in mixed.items()), key=lambda row: -row[1]))


def _verdict(probabilities: Mapping[str, float]) -> Verdict:
    first = next(iter(probabilities))
    if first in ("none", "unknown"):
        return first  # type: ignore[return-value]
    return "effect"


def equivalents(ranking: Ranking) -> tuple[tuple[str, ...], ...]:
    """The best effect with those that are as evident: of its class, or within the same nats."""
    if not ranking.found or ranking.found[0].log_evidence <= 0.0:
        return ()
    best = ranking.found[0]
    name = best.effects[-1].effect.name
    kin = {other for group in CLASSES if name in group for other in group}
    near: list[str] = [name]
    strength = trust(ranking)
    for one in ranking.found[1:]:
        other = one.effects[-1].effect.name
        behind = strength * (best.log_evidence - one.log_evidence)
        if other not in near and behind < (NEAR if other not in kin else 2.0 * NEAR):
            near.append(other)
    return (tuple(near),) if len(near) > 1 else ()


def interval(
    one: Explained, bench_deviation: np.ndarray, prior: Sequence, temper: float
) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns of the effects at both ends of their 90 % intervals, by Laplace's approximation."""
    n = one.n_own
    deviation = np.concatenate([[p.deviation for p in prior], bench_deviation])
    h = one.fit.curvature / temper + np.diag(1.0 / deviation**2)
    spread = WIDER * np.sqrt(np.maximum(np.diag(np.linalg.pinv(h))[:n], 0.0)) + ROUGH
    lowest = np.array([p.lowest for p in prior])
    return np.maximum(one.fit.x[:n] - 1.645 * spread, lowest), one.fit.x[:n] + 1.645 * spread
