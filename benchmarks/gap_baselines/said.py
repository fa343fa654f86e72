"""What a method says about a recording, in the form of the diagnosis."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lagsplat.diagnose.core.result import Block, Candidate, Diagnosis, Parameter, Verdict
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.report.diagnosis.content import save_rollouts
from lagsplat.report.diagnosis.serialization import save_diagnosis

APART = ("none", "unknown")


@dataclass(frozen=True)
class Said:
    """Shares of one for the names it thinks of, the place of the first and its parameters (value, low, high).

    The verdict is the first name where that is ``none`` or ``unknown``, and an effect otherwise.
    """

    probability: Mapping[str, float]
    coordinate: str | None = None
    input: str | None = None
    parameters: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    blocks: tuple[Block, ...] = ()
    """Forecasts of the held-out half, where it names an effect."""
    others: tuple[str, ...] = ()
    """Effects that it says act beside the first."""

    @property
    def first(self) -> str:
        """The most probable name, the first of equals."""
        return max(self.probability, key=lambda name: self.probability[name])


def weigh(scores: Mapping[str, float], first: str) -> dict[str, float]:
    """Shares of one from log likelihoods; ``first``, which a method chose, gets no less than any other."""
    top = max(scores.values())
    shares = {name: float(np.exp(score - top)) for name, score in scores.items()}
    shares = {first: 0.0, **shares}
    shares[first] = max(shares.values())
    total = sum(shares.values())
    return {name: share / total for name, share in shares.items()}


def names() -> list[str]:
    """Every name that an effect may have, in the alphabet's order."""
    return sorted(catalogue())


def diagnosis(said: Said) -> Diagnosis:
    """The diagnosis that says just this; names that were not thought of get nothing."""
    first = said.first
    named = first not in APART
    order = sorted(said.probability, key=lambda name: -said.probability[name])
    order += [name for name in [*names(), *APART] if name not in said.probability]
    candidates = tuple(
        Candidate(
            name,
            said.probability.get(name, 0.0),
            coordinate=said.coordinate if name == first else None,
            input=said.input if name == first else None,
            parameters={
                key: Parameter(*values, "")
                for key, values in (said.parameters.items() if name == first else ())
            },
        )
        for name in order
    )
    verdict: Verdict = "effect" if named else "none" if first == "none" else "unknown"
    return Diagnosis(
        verdict=verdict,
        candidates=candidates,
        combination=(first, *said.others) if named else (),
        gap=None,
        where={"coordinates": {said.coordinate: 1.0}} if named and said.coordinate else None,
        equivalent=(),
        excitation=(),
        warnings=(),
        absorbed=(),
        blocks=said.blocks,
        checks={},
    )


def write(said: Said, out: Path) -> None:
    """Write ``diagnosis.json``, and ``rollouts.csv`` where there are forecasts, into the folder ``out``.

    Raises:
        ValueError: probabilities that are no shares of one.
    """
    if said.blocks:
        save_rollouts(out / "rollouts.csv", said.blocks)
    save_diagnosis(out / "diagnosis.json", diagnosis(said))
