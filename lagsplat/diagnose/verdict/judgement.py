"""The verdict: the most probable alternative, with the probability of every name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import VERDICT
from lagsplat.diagnose.core.result import Verdict
from lagsplat.diagnose.inference.problem import HypothesisFit
from lagsplat.diagnose.verdict.alternatives import Alternatives, Measures
from lagsplat.diagnose.verdict.choice_model import ChoiceModel
from lagsplat.diagnose.verdict.features import compute_features


@dataclass(frozen=True)
class Judgement:
    """Probabilities of all names, the most probable first, the best explanation, and the verdict."""

    verdict: Verdict
    probabilities: Mapping[str, float]
    equivalent: tuple[tuple[str, ...], ...]  # effects that the recording does not tell apart
    best: HypothesisFit | None  # the most probable effect or set, whether or not the verdict names it

    def reject(self, verdict: Verdict) -> "Judgement":
        """The judgement with another verdict, `none` or `unknown`, which swaps its probability with the
        most probable name."""
        probabilities, first = dict(self.probabilities), next(iter(self.probabilities))
        probabilities[verdict], probabilities[first] = probabilities[first], probabilities[verdict]
        return replace(self, verdict=verdict, probabilities=_sort(probabilities), equivalent=())


def judge_alternatives(
    alternatives: Alternatives, model: ChoiceModel, *, catalogue: Sequence[str]
) -> Judgement:
    """Weigh the alternatives by a calibrated model.

    The probability of a set counts for its main cause. The verdict is the most probable name, explained by
    the most probable alternative that stands for it. Names of the ``catalogue`` that were not fitted have no
    probability.
    """
    chances = np.exp(model.log_probabilities(compute_features(alternatives)))
    mains = name_main_causes(alternatives.measures)
    probabilities = _sort(dict.fromkeys(("none", "unknown", *catalogue), 0.0) | sum_by_cause(mains, chances))
    first = next(iter(probabilities))
    verdict: Verdict = "none" if first == "none" else "unknown" if first == "unknown" else "effect"
    causes = [name for name in probabilities if name in mains[1:-1]]
    if not causes:
        return Judgement(verdict, probabilities, (), None)
    at = max((i for i, main in enumerate(mains) if main == causes[0]), key=lambda i: chances[i])
    names = [m.names for m in alternatives.measures]
    return Judgement(verdict, probabilities, _list_equivalent(names, chances, at), alternatives.fits[at])


def name_main_causes(measures: Sequence[Measures]) -> tuple[str, ...]:
    """The name that each alternative stands for, `none` first and `unknown` last.

    Of a set it is the effect with the most evidence alone.
    """
    alone = {m.names[0]: m.log_evidence for m in measures if len(m.names) == 1}
    mains = (max(m.names, key=lambda name: alone.get(name, -np.inf)) for m in measures[1:])
    return ("none", *mains, "unknown")


def sum_by_cause(mains: Sequence[str], chances: Float64[np.ndarray, " n"]) -> dict[str, float]:
    """Probability of every name of being the main cause, the most probable first.

    ``chances`` (n,) are the probabilities of the alternatives, ``mains`` what they stand for.
    """
    sums = dict.fromkeys(mains, 0.0)
    for main, chance in zip(mains, chances, strict=True):
        sums[main] += float(chance)
    return _sort(sums)


def _list_equivalent(
    names: Sequence[tuple[str, ...]], chances: np.ndarray, best: int
) -> tuple[tuple[str, ...], ...]:
    """The fewest single effects that hold `VERDICT.credible` of what all single effects have."""
    if len(names[best]) > 1:
        return ()
    single = [i for i in range(1, len(names)) if len(names[i]) == 1]
    ordered = sorted(single, key=lambda i: -chances[i])
    share = np.cumsum(chances[ordered]) / max(float(np.sum(chances[ordered])), 1e-300)
    kept = ordered[: int(np.argmax(share >= VERDICT.credible)) + 1]
    return (tuple(names[i][0] for i in kept),) if len(kept) > 1 else ()


def _sort(probabilities: Mapping[str, float]) -> dict[str, float]:
    return dict(sorted(probabilities.items(), key=lambda row: -row[1]))
