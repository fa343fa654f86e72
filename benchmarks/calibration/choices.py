"""Choices from measured recordings: which alternatives there were, and which of them are right."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.diagnose.verdict.alternatives import Alternatives, Measures
from lagsplat.diagnose.verdict.choice_model import Choice
from lagsplat.diagnose.verdict.features import compute_features

SHARED = ("nominal", "chance", "relaxed_log_evidence", "motionless")  # of all alternatives of a recording
LEFT_OUT_WEIGHT = 0.25  # of a recording without its true effect: so about a fifth have an unknown cause


@dataclass(frozen=True)
class LabelledChoice:
    """A choice, where it comes from and what is true of it.

    ``names`` are the alternatives; ``kind`` is "none", "single", "pair", "outside" (of the catalogue) or
    "left_out" (the true effect is not in the catalogue); ``families`` are the names of the true effects.
    """

    choice: Choice
    names: tuple[tuple[str, ...], ...]
    kind: str
    source: str
    recording: str
    families: frozenset[str]


def read_rows(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """Rows of all files, in the order of the names; those with an error are left out."""
    lines = (line for path in paths for line in path.read_text(encoding="utf-8").splitlines())
    rows = (json.loads(line) for line in lines)
    return sorted((row for row in rows if "full" in row), key=lambda row: str(row["id"]))


def pack_alternatives(alternatives: Alternatives) -> dict[str, Any]:
    """Measures as JSON holds them, with the coordinate or input where each effect acts."""
    rows = [
        asdict(measures) | {"places": [str(placed.location) for placed in fit.effects]}
        for measures, fit in zip(alternatives.measures, alternatives.fits, strict=True)
    ]
    return {"measures": rows, **{name: getattr(alternatives, name) for name in SHARED}}


def unpack_alternatives(packed: Mapping[str, Any]) -> Alternatives:
    """Alternatives without their fits."""
    measures = []
    for row in packed["measures"]:
        numbers = {name: value for name, value in row.items() if name != "places"}
        measures.append(Measures(**{**numbers, "names": tuple(row["names"])}))
    return Alternatives(tuple(measures), (), **{name: packed[name] for name in SHARED})


def label_rows(rows: Sequence[Mapping[str, Any]]) -> list[LabelledChoice]:
    """Choices of all rows.

    Recordings are left out in which physics hides the effect, or of which the data allow no verdict.
    """
    labelled = []
    for row in rows:
        answer = row["answer"]
        truth = answer["truth"]
        if not answer["identifiable"] or row["undetermined"]:
            continue
        outside = bool(truth) and all(effect["name"] == "unknown" for effect in truth)
        kind = "none" if not truth else "outside" if outside else "pair" if len(truth) > 1 else "single"
        labelled.append(_label(row, "full", kind))
        if "left_out" in row:
            labelled.append(_label(row, "left_out", "left_out"))
    return labelled


def _label(row: Mapping[str, Any], which: str, kind: str) -> LabelledChoice:
    alternatives, answer = unpack_alternatives(row[which]), row["answer"]
    names = (("none",), *(m.names for m in alternatives.measures[1:]), ("unknown",))
    if kind == "none":
        right = np.array([name == ("none",) for name in names])
    elif kind in ("outside", "left_out"):
        right = np.array([name == ("unknown",) for name in names])
    else:
        score = np.array([_score_names(name, answer["truth"]) for name in names])
        right = (score > 0.0) & (score > score.max() - 1e-9)
    weight = LEFT_OUT_WEIGHT if kind == "left_out" else 1.0
    return LabelledChoice(
        Choice(compute_features(alternatives), right, weight),
        names,
        kind,
        answer["source"] or "own",
        row["id"],
        frozenset(effect["kind"] for effect in answer["truth"]),
    )


def _score_names(names: Sequence[str], truth: Sequence[Mapping[str, Any]]) -> float:
    """F1 of a set of names against the true effects; a name counts for an effect that it can pass for."""
    left = set(names)
    hits = 0
    for effect in truth:
        found = sorted(left & set(effect["class"]))
        if found:
            hits += 1
            left.remove(found[0])
    return 2.0 * hits / (len(names) + len(truth))
