"""The verdict: the most probable alternative, with the probability of every name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.core.config import VERDICT
from lagsplat.diagnose.core.result import Verdict
from lagsplat.diagnose.inference.problem import HypothesisFit
from lagsplat.diagnose.verdict.alternatives import Alternatives
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

    The probability of a set counts for that of its effects which has the most evidence alone, so that each
    name has the probability of being the main cause. Names of the ``catalogue`` that were not fitted have
    none.
    """
    chances = np.exp(model.log_probabilities(compute_features(alternatives)))
    names = [m.names for m in alternatives.measures]
    probabilities = {"none": float(chances[0]), "unknown": float(chances[-1])}
    probabilities |= dict.fromkeys(catalogue, 0.0)
    alone = {m.names[0]: m.log_evidence for m in alternatives.measures if len(m.names) == 1}
    for members, chance in zip(names[1:], chances[1:-1], strict=True):
        main = max(members, key=lambda name: alone.get(name, -np.inf))
        probabilities[main] += float(chance)
    first = int(np.argmax(chances))
    verdict: Verdict = "none" if first == 0 else "unknown" if first == len(names) else "effect"
    best = None
    equivalent: tuple[tuple[str, ...], ...] = ()
    if len(names) > 1:
        at = 1 + int(np.argmax(chances[1:-1]))
        best = alternatives.fits[at]
        equivalent = _list_equivalent(names, chances, at)
    return Judgement(verdict, _sort(probabilities), equivalent, best)


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
