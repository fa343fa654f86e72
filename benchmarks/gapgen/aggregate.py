"""The figures of merit of one set of predictions, over all recordings and over each stratum."""

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.gapgen.metrics import (
    ABSTAINED,
    Item,
    brier,
    calibration,
    closures,
    largest,
    log_score,
    macro_f1,
    match_names,
    overlap,
    parameter_errors,
    set_f1,
    share,
    wilson,
)

STRATA = ("noise", "duration_s", "bin", "forced", "d", "system")


def _spread(values: list[float]) -> dict[str, float]:
    if not values:
        return {"median": float("nan"), "p10": float("nan"), "n": 0}
    return {"median": float(np.median(values)), "p10": float(np.quantile(values, 0.1)), "n": len(values)}


def _where(items: list[Item]) -> dict[str, Any]:
    """Shares of right levels, components, coordinates and inputs, time overlap and frequency error."""
    one = [i for i in items if i.kind == "single"]

    def of(test: Callable[[Item], bool | None]) -> dict[str, float]:
        known = [(item, test(item)) for item in one]
        return share([item for item, found in known if found is not None], lambda item: bool(test(item)))

    def level(item: Item) -> bool | None:
        said = item.said.where.get("level")
        camera = {"perception", "chart"}
        true = item.truth["truth"][0]["level"]
        return None if said is None else said == true or {said, true} <= camera

    def component(item: Item) -> bool | None:
        true, said = item.truth["truth"][0]["component"], largest(item.said.where.get("components"))
        return None if true is None or said is None else said == true

    def coordinate(item: Item) -> bool | None:
        true = item.truth["truth"][0]["coordinate"]
        if true is None or item.truth["d"] < 2 or item.said.verdict == "missing":
            return None
        return largest(item.said.where.get("coordinates")) == true

    def channel(item: Item) -> bool | None:
        true = item.truth["truth"][0]["input"]
        entry = item.said.candidates.get(item.first)
        if true is None or item.truth["d"] < 2 or entry is None or item.first not in item.accepted:
            return None
        return entry.get("input") == true

    def effect_coordinate(item: Item) -> bool | None:
        true = item.truth["truth"][0]["coordinate"]
        entry = item.said.candidates.get(item.first)
        if true is None or item.truth["d"] < 2 or entry is None or item.first not in item.accepted:
            return None
        return entry.get("coordinate") == true

    times = [
        overlap(i.said.where.get("time_s") or [], i.truth["truth"][0]["time_s"])
        for i in one
        if i.truth["truth"][0]["time_s"]
    ]
    lines = []
    for i in one:
        said = (i.said.candidates.get(i.first) or {}).get("parameters") or {}
        if i.truth["truth"][0]["frequency_hz"] and "frequency_hz" in said:
            true = i.truth["truth"][0]["frequency_hz"][0]
            lines.append(abs(said["frequency_hz"]["value"] - true) / true)
    return {
        "level": of(level),
        "component": of(component),
        "coordinate": of(coordinate),
        "coordinate_of_effect": of(effect_coordinate),
        "input_of_effect": of(channel),
        "time_overlap": _spread(times),
        "frequency_error": _spread(lines),
    }


def _parameters(items: list[Item]) -> dict[str, Any]:
    rows = [row for i in items if i.kind == "single" for row in parameter_errors(i)]
    by_name: dict[str, list[float]] = {}
    for name, error, _, _ in rows:
        by_name.setdefault(name, []).append(error)
    return {
        "relative_error": _spread([row[1] for row in rows]),
        "error_over_change": _spread([row[2] for row in rows]),
        "coverage": _share_of([row[3] for row in rows]),
        "by_parameter": {name: _spread(values) for name, values in sorted(by_name.items())},
    }


def _share_of(marks: list[bool]) -> dict[str, float]:
    value, low, high = wilson(sum(marks), len(marks))
    return {"value": value, "low": low, "high": high, "n": len(marks)}


def aggregate(items: list[Item]) -> dict[str, Any]:
    """Every metric over the items; shares come with Wilson's interval and their number.

    ``top1`` and its like are over identifiable recordings of one effect of the catalogue; calibration and
    Brier score over all recordings but pairs.
    """
    single = [i for i in items if i.kind == "single" and i.truth["identifiable"]]
    every = [i for i in items if i.kind == "single"]
    pairs = [i for i in items if i.kind == "pair"]
    named = [i for i in items if i.kind != "pair" and i.said.verdict != "missing"]
    predicted = [i for i in single if i.said.verdict != "missing"]
    answered = [i for i in single if i.said.verdict not in ABSTAINED]
    right = np.array([i.among(1, whole_class=True) for i in named], float)
    confidence = np.array([i.confidence(whole_class=True) for i in named])
    family = np.array([i.among(1, whole_class=False) for i in named], float)
    family_confidence = np.array([i.confidence(whole_class=False) for i in named])
    found = [
        c for c in map(closures, [*single, *(i for i in pairs if i.truth["identifiable"])]) if c is not None
    ]
    ece, curve = calibration(confidence, right)
    return {
        "recordings": len(items),
        "missing": sum(i.said.verdict == "missing" for i in items),
        "top1_class": share(single, lambda i: i.among(1, whole_class=True)),
        "top2_class": share(single, lambda i: i.among(2, whole_class=True)),
        "top1_family": share(single, lambda i: i.among(1, whole_class=False)),
        "top2_family": share(single, lambda i: i.among(2, whole_class=False)),
        "top1_class_named": share(
            single, lambda i: i.said.verdict == "effect" and i.among(1, whole_class=True)
        ),
        "top1_class_answered": share(answered, lambda i: i.among(1, whole_class=True)),
        "top1_class_predicted": share(predicted, lambda i: i.among(1, whole_class=True)),
        "top1_class_every": share(every, lambda i: i.among(1, whole_class=True)),
        "macro_f1": macro_f1(single),
        "false_alarms": share([i for i in items if i.kind == "none"], lambda i: i.said.verdict == "effect"),
        "abstention_outside": share(
            [i for i in items if i.kind == "outside"], lambda i: i.said.verdict in ABSTAINED
        ),
        "unknown_outside": share(
            [i for i in items if i.kind == "outside"], lambda i: i.said.verdict == "unknown"
        ),
        "false_abstention": share(single, lambda i: i.said.verdict in ABSTAINED),
        "unnamed_outside": share(
            [i for i in items if i.kind == "outside"], lambda i: i.said.verdict != "effect"
        ),
        "unnamed": share(single, lambda i: i.said.verdict != "effect"),
        "wrong_names": share(items, lambda i: bool(match_names(i, whole_class=True)[1])),
        "missed": share(single, lambda i: i.said.verdict == "none"),
        "ece_class": ece,
        "calibrated": len(named),
        "ece_family": calibration(family_confidence, family)[0],
        "brier_class": brier(named, whole_class=True),
        "log_score_class": log_score(named),
        "brier_family": brier(named, whole_class=False),
        "reliability": curve,
        "set_f1_class": _spread([set_f1(i, whole_class=True) for i in pairs])
        | {"mean": float(np.mean([set_f1(i, whole_class=True) for i in pairs])) if pairs else float("nan")},
        "closure": _spread([c for c, _ in found]),
        "closure_over_oracle": _spread([c / o for c, o in found]),
        "where": _where(items),
        "parameters": _parameters(items),
    }


def by_stratum(items: list[Item]) -> dict[str, dict[str, Any]]:
    """Top-1 and top-2 at class level, false alarms and closure in every stratum."""
    out: dict[str, dict[str, Any]] = {}
    for name in STRATA:
        for value in sorted({i.truth[name] for i in items}, key=str):
            whole = aggregate([i for i in items if i.truth[name] == value])
            wanted = ("recordings", "top1_class", "top2_class", "false_alarms", "abstention_outside")
            out[f"{name}={value}"] = {
                key: whole[key] for key in (*wanted, "false_abstention", "closure_over_oracle")
            }
    return out


def by_effect(items: list[Item]) -> dict[str, dict[str, float]]:
    """Top-1 at class level for every true name."""
    kinds = {i.label for i in items if i.kind != "pair"}
    return {
        kind: share(
            [i for i in items if i.kind != "pair" and i.label == kind], lambda i: i.among(1, whole_class=True)
        )
        for kind in sorted(kinds)
    }


def permuted_top1(items: list[Item], *, rounds: int = 20) -> float:
    """Top-1 at class level against answers dealt out at random: about chance unless something leaks."""
    single = [i for i in items if i.kind == "single" and i.truth["identifiable"]]
    rng = np.random.default_rng(0)
    hits = [
        single[k].first in single[other].accepted
        for _ in range(rounds)
        for k, other in enumerate(rng.permutation(len(single)))
    ]
    return float(np.mean(hits)) if hits else float("nan")
