"""Choices from measured recordings: which alternatives there were, and which of them are right."""

import json
import lzma
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from benchmarks.gapgen.answers import SMALLEST_GAP
from benchmarks.gapgen.strata import OUTSIDE_SHARE
from lagsplat.diagnose.verdict.alternatives import Alternatives, Measures
from lagsplat.diagnose.verdict.features import compute_features
from lagsplat.diagnose.verdict.judgement import name_main_causes

SHARED = ("nominal", "chance", "relaxed_log_evidence", "motionless")  # of all alternatives of a recording
DIGITS = 5  # of stored numbers: no share moves by more than one recording against six
DECISIVE = 3.0  # log Bayes factor [nat], 20 to 1: strong evidence by Kass and Raftery (1995)
LEFT_OUT_WEIGHT = 0.5  # of a recording without its true effect: so about a quarter have an unknown cause
EARLIER_WEIGHT = 0.2  # of a row of earlier code: later ones, by tenths left out, are then the most likely


@dataclass(frozen=True)
class Choice:
    """One recording: the features (n, k) of its alternatives, and which of them are right (n,)."""

    features: Float64[np.ndarray, "n k"]
    right: Bool[np.ndarray, " n"]
    weight: float = 1.0


@dataclass(frozen=True)
class LabelledChoice:
    """A choice, where it comes from and what is true of it.

    ``names`` are the alternatives and ``mains`` the causes that they stand for; ``kind`` is "none", "single",
    "pair", "outside" (of the catalogue), "left_out" (the true effect is not in the catalogue) or "exact" (the
    tolerances of the sim close the gap, and are left out); ``truth`` are the true effects.
    """

    choice: Choice
    names: tuple[tuple[str, ...], ...]
    mains: tuple[str, ...]
    kind: str
    truth: Sequence[Mapping[str, Any]]
    source: str
    recording: str
    earlier: bool = False  # measured by earlier code

    @property
    def families(self) -> frozenset[str]:
        """Names of the true effects."""
        return frozenset(effect["kind"] for effect in self.truth)

    @property
    def true_names(self) -> frozenset[str]:
        """All names that are right for one of the true effects."""
        return list_true_names(self.truth)


def list_true_names(truth: Iterable[Mapping[str, Any]]) -> frozenset[str]:
    """All names that are right for one of the true effects."""
    return frozenset(name for effect in truth for name in effect["class"])


def read_rows(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """Rows of all files, plain or compressed (``.xz``), in the order of their names; errors are left out."""
    rows = []
    for path in paths:
        with lzma.open(path, "rt") if path.suffix == ".xz" else path.open(encoding="utf-8") as lines:
            rows += [json.loads(line) for line in lines]
    return sorted((row for row in rows if "full" in row), key=lambda row: str(row["id"]))


def write_rows(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows to a compressed file, numbers to `DIGITS` digits; the same rows give the same bytes."""

    def shorten(value: Any) -> Any:
        if isinstance(value, float):
            return float(f"{value:.{DIGITS}g}")
        if isinstance(value, Mapping):
            return {name: shorten(part) for name, part in value.items()}
        return [shorten(part) for part in value] if isinstance(value, list | tuple) else value

    text = "".join(json.dumps(shorten(row), separators=(",", ":")) + "\n" for row in rows)
    path.write_bytes(lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME))


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

    Recordings are left out in which physics or noise hides the effect, as a generator does not always reach
    the gap that it aims at, or of which the data allow no verdict. Where the sim's own tolerances close the
    gap, `none` is right as well, and an exact sim shows the cause. A recording without its true effect counts
    if no other effect imitates it. Rows that are ``earlier``, measured by code that fitted otherwise, count
    for less.
    """
    labelled = []
    for row in rows:
        answer = row["answer"]
        truth = answer["truth"]
        hidden = bool(truth) and not (answer["gap_ratio"] or 0.0) >= SMALLEST_GAP
        if hidden or not answer["identifiable"] or row["undetermined"]:
            continue
        outside = bool(truth) and all(effect["name"] == "unknown" for effect in truth)
        kind = "none" if not truth else "outside" if outside else "pair" if len(truth) > 1 else "single"
        labelled.append(_label(row, "full", kind))
        labelled += [_label(row, "exact", "exact")] if "exact" in row else []
        if "left_out" in row and not _is_imitated(row):
            labelled.append(_label(row, "left_out", "left_out"))
    return _balance_outside(labelled)


def _balance_outside(labelled: Sequence[LabelledChoice]) -> list[LabelledChoice]:
    sums: Counter[frozenset[str]] = Counter()
    for each in labelled:
        if each.kind == "outside":
            sums[each.families] += each.choice.weight
    others = sum(each.choice.weight for each in labelled if each.kind in ("none", "single", "pair"))
    if not (sums and others):
        return list(labelled)
    each_weighs = OUTSIDE_SHARE / (1.0 - OUTSIDE_SHARE) * others / len(sums)
    balanced = []
    for each in labelled:
        weight = each.choice.weight
        if each.kind == "outside":
            weight *= each_weighs / sums[each.families]
        balanced.append(replace(each, choice=replace(each.choice, weight=weight)))
    return balanced


def _is_imitated(row: Mapping[str, Any]) -> bool:
    """Whether what is left without the true effects explains the recording as well as they do."""
    names = list_true_names(row["answer"]["truth"])
    true = [m["log_evidence"] for m in row["full"]["measures"][1:] if names & set(m["names"])]
    others = [m["log_evidence"] for m in row["left_out"]["measures"]]
    return max(true, default=-np.inf) < max(others) + DECISIVE and max(others) > DECISIVE


def _label(row: Mapping[str, Any], which: str, kind: str) -> LabelledChoice:
    alternatives, answer = unpack_alternatives(row[which]), row["answer"]
    names = (("none",), *(m.names for m in alternatives.measures[1:]), ("unknown",))
    truth = [] if kind == "left_out" else answer["truth"]
    score = np.array([score_names(name, truth) for name in names])
    right = (score > 0.0) & (score > score.max() - 1e-9)
    right[0] = not answer["truth"] or (kind == "single" and "exact" in row)
    right[-1] |= kind == "left_out"
    weight, earlier = LEFT_OUT_WEIGHT if kind == "left_out" else 1.0, bool(row.get("earlier"))
    return LabelledChoice(
        Choice(compute_features(alternatives), right, weight * (EARLIER_WEIGHT if earlier else 1.0)),
        names,
        name_main_causes(alternatives.measures),
        kind,
        answer["truth"],
        answer["source"] or "own",
        row["id"],
        earlier,
    )


def score_names(names: Sequence[str], truth: Sequence[Mapping[str, Any]]) -> float:
    """F1 of a set of names against the true effects; a name counts for an effect that it can pass for."""
    left = set(names)
    hits = 0
    for effect in truth:
        found = sorted(left & set(effect["class"]))
        if found:
            hits += 1
            left.remove(found[0])
    return 2.0 * hits / (len(names) + len(truth))
