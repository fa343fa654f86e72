"""What a method says about a recording, in the form of the diagnosis."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lagsplat.diagnose.catalogue import catalogue
from lagsplat.diagnose.result import Block
from lagsplat.report.diagnosis_rollouts import save_rollouts

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
    """Its forecasts, where it makes any."""

    @property
    def first(self) -> str:
        """The most probable name, the first of equals."""
        return max(self.probability, key=lambda name: self.probability[name])


def names() -> list[str]:
    """Every name that an effect may have, in the alphabet's order."""
    return sorted(catalogue())


def content(said: Said) -> dict[str, Any]:
    """The content of ``diagnosis.json``; names that were not thought of get nothing."""
    first = said.first
    order = sorted(said.probability, key=lambda name: -said.probability[name])
    order += [name for name in [*names(), *APART] if name not in said.probability]
    effects = [
        {
            "name": name,
            "probability": said.probability.get(name, 0.0),
            "coordinate": said.coordinate if name == first else None,
            "input": said.input if name == first else None,
            "parameters": {
                key: {"value": value, "low": low, "high": high, "unit": ""}
                for key, (value, low, high) in (said.parameters.items() if name == first else ())
            },
            "closure": {"value": None, "low": None, "high": None},
        }
        for name in order
    ]
    named = first not in APART
    return {
        "schema": 1,
        "verdict": "effect" if named else first,
        "effects": effects,
        "combination": [first] if named else [],
        "where": {"coordinates": {said.coordinate: 1.0} if named and said.coordinate else {}},
        "gap": {},
        "equivalent": [],
        "excitation": [],
        "warnings": [],
    }


def write(said: Said, out: Path) -> None:
    """Write ``diagnosis.json``, and ``rollouts.csv`` where there are forecasts, into the folder ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    if said.blocks:
        save_rollouts(out / "rollouts.csv", said.blocks)
    (out / "diagnosis.json").write_text(json.dumps(content(said), indent=1) + "\n", encoding="utf-8")
