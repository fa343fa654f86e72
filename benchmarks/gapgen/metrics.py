"""Metrics of a blind check: ranks, abstention, calibration, sets, closure, places, parameters."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from benchmarks.gapgen.predictions import Prediction

Array = NDArray[np.float64]
SCORED = {
    "viscous_damping": ("rate",),
    "linear_stiffness": ("ratio",),
    "mass_change": ("ratio",),
    "constant_force": ("acceleration",),
    "input_gain": ("ratio",),
    "cubic_stiffness": ("coefficient",),
    "coulomb_friction": ("acceleration",),
    "stribeck_friction": ("coulomb", "static"),
    "load_dependent_friction": ("acceleration",),
    "quadratic_drag": ("coefficient",),
    "input_lag": ("time_constant",),
    "input_delay": ("delay",),
    "input_dead_zone": ("half_width",),
    "input_saturation": ("limit",),
    "input_backlash": ("width",),
    "hysteresis": ("acceleration", "displacement"),
    "creep": ("stiffness_ratio", "time_constant"),
    "joint_backlash": ("gap",),
    "end_stop": ("position",),
    "external_periodic_force": ("frequency_hz", "acceleration"),
    "parameter_drift": ("rate",),
    "hidden_mode": ("frequency_hz", "mass_ratio"),
    "time_offset": ("offset",),
    "time_jitter": ("std",),
}
ABSTAINED = ("unknown", "undetermined", "missing")


@dataclass(frozen=True)
class Item:
    """A recording's truth and what was said about it."""

    truth: dict[str, Any]
    said: Prediction

    @property
    def kind(self) -> str:
        """``none``, ``outside``, ``pair`` or ``single``."""
        effects = self.truth["effects"]
        if effects == ["none"]:
            return "none"
        return "pair" if len(effects) > 1 else "outside" if effects == ["unknown"] else "single"

    @property
    def label(self) -> str:
        """The name that is right at the family level."""
        return str(self.truth["effects"][0])

    @property
    def accepted(self) -> set[str]:
        """Names that are right at the class level."""
        return set(self.truth["truth"][0]["class"]) if self.truth["truth"] else {"none"}

    @property
    def first(self) -> str:
        """The name ranked first."""
        return self.said.ranking[0] if self.said.ranking else "missing"

    def among(self, k: int, *, whole_class: bool) -> bool:
        """Whether one of the first ``k`` names is right."""
        right = self.accepted if whole_class else {self.label}
        return bool(right & set(self.said.ranking[:k]))

    def confidence(self, *, whole_class: bool) -> float:
        """Probability of the first name, or of the class it shares with the truth."""
        names = self.accepted if whole_class and self.first in self.accepted else {self.first}
        return min(sum(self.said.probability.get(name, 0.0) for name in names), 1.0)


def wilson(hits: int, n: int, *, level: float = 0.95) -> tuple[float, float, float]:
    """Share and Wilson's interval for it; nan without trials."""
    if not n:
        return (float("nan"),) * 3
    z = float(norm.ppf(0.5 + level / 2.0))
    p = hits / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    # at the ends the interval touches 0 or 1 but for rounding
    return p, max(0.0, centre - half) if hits else 0.0, min(1.0, centre + half) if hits < n else 1.0


def share(items: Iterable[Item], right: Callable[[Item], bool]) -> dict[str, float]:
    """Share of the items that are right, Wilson's interval and their number."""
    marks = [right(item) for item in items]
    value, low, high = wilson(sum(marks), len(marks))
    return {"value": value, "low": low, "high": high, "n": len(marks)}


def calibration(
    confidence: Array, right: Array, *, bins: int = 15
) -> tuple[float, list[tuple[float, float, int]]]:
    """Expected calibration error over bins of equal mass; (mean confidence, accuracy, count) of each.

    Equal confidences stand in one bin.
    """
    if not len(confidence):
        return float("nan"), []
    edges = np.unique(np.quantile(confidence, np.linspace(0.0, 1.0, bins + 1)))
    place = np.searchsorted(edges[1:-1], confidence, side="left")
    groups = [np.flatnonzero(place == k) for k in np.unique(place)]
    curve = [(float(confidence[g].mean()), float(right[g].mean()), len(g)) for g in groups]
    error = sum(n * abs(c - a) for c, a, n in curve) / len(confidence)
    return float(error), curve


def brier(items: list[Item], *, whole_class: bool) -> float:
    """Multi-class Brier score, the names of the true class taken as one where asked."""
    scores = []
    for item in items:
        right = item.accepted if whole_class else {item.label}
        inside = sum(p for name, p in item.said.probability.items() if name in right)
        outside = [p for name, p in item.said.probability.items() if name not in right]
        scores.append((inside - 1.0) ** 2 + float(np.square(outside).sum()))
    return float(np.mean(scores)) if scores else float("nan")


def log_score(items: list[Item]) -> float:
    """Mean of minus the logarithm of the probability given to the true class, at least one in a million."""
    given = [sum(p for name, p in i.said.probability.items() if name in i.accepted) for i in items]
    return float(-np.log(np.clip(given, 1e-6, 1.0)).mean()) if given else float("nan")


def match_names(item: Item, *, whole_class: bool) -> tuple[int, list[str]]:
    """How many true effects are named, each by at most one name, and the names that are left over.

    These are wrong: of another effect, or invented where there is none or nothing more.
    """
    left = list(dict.fromkeys(item.said.combination))
    hits = 0
    for entry in item.truth["truth"]:
        right = set(entry["class"]) if whole_class else {entry["name"]}
        match = next((name for name in left if name == entry["name"]), None)
        match = match or next((name for name in left if name in right), None)
        if match:
            left.remove(match)
            hits += 1
    return hits, left


def set_f1(item: Item, *, whole_class: bool) -> float:
    """F1 of the named set against the true one, each true effect matched by at most one name."""
    hits, _ = match_names(item, whole_class=whole_class)
    named = len(set(item.said.combination))
    return 2.0 * hits / (named + len(item.truth["truth"]))


def closures(item: Item) -> tuple[float, float] | None:
    """Closure reached, recomputed from the rollouts, and the oracle's; None where there is no gap to close.

    A prediction without rollouts, or that names no effect, has closed nothing.
    """
    g = item.truth["gap"]
    room = g["before"] - g["floor"]
    if not room > 0.3 * g["floor"] or not g["before"] - g["after"] > 0.5 * room:
        return None
    oracle = (g["before"] - g["after"]) / room
    if item.said.gaps is None or item.said.verdict != "effect":
        return 0.0, oracle
    before, after = item.said.gaps
    if not before > g["floor"]:
        return None
    return float(np.clip((before - after) / (before - g["floor"]), -1.0, 1.2)), oracle


def parameter_errors(item: Item) -> list[tuple[str, float, float, bool]]:
    """(parameter, relative error, error over the change, truth inside the interval) of a right family.

    The change of a ratio is its distance from one; other parameters change from zero.
    """
    entry = item.truth["truth"][0]
    if item.first != entry["name"]:
        return []
    said = item.said.candidates[item.first].get("parameters") or {}
    out = []
    for name in SCORED.get(item.first, ()):
        true, found = entry["parameters"].get(name), said.get(name)
        if found is None or true is None or not abs(true) > 0.0:
            continue
        wrong = abs(found["value"] - true)
        change = abs(true - 1.0) if name == "ratio" else abs(true)
        low, high = sorted((found["low"], found["high"]))
        out.append(
            (f"{item.first}.{name}", wrong / abs(true), wrong / max(change, 1e-12), low <= true <= high)
        )
    return out


def largest(shares: dict[str, float] | None) -> str | None:
    """The key of the largest share."""
    return max(shares, key=lambda name: shares[name]) if shares else None


def overlap(said: list[list[Any]], true: list[list[float]]) -> float:
    """Intersection over union of time intervals; said ones end in (start, end, share), maybe after a file."""
    spans = [tuple(float(x) for x in row[-3:-1]) if len(row) >= 3 else tuple(map(float, row)) for row in said]
    edges = sorted({x for span in [*spans, *map(tuple, true)] for x in span})
    both = either = 0.0
    for a, z in pairwise(edges):
        middle = 0.5 * (a + z)
        inside = [any(s[0] <= middle <= s[1] for s in group) for group in (spans, true)]
        both += (z - a) * all(inside)
        either += (z - a) * any(inside)
    return both / either if either else 0.0


def risk_coverage(items: list[Item]) -> tuple[Array, Array]:
    """Share answered and the share wrong among them as the demanded confidence falls (class level)."""
    order = sorted(items, key=lambda item: -item.confidence(whole_class=True))
    wrong = np.array([not item.among(1, whole_class=True) for item in order], float)
    count = np.arange(1, len(wrong) + 1)
    return count / max(len(wrong), 1), np.cumsum(wrong) / count


def macro_f1(items: list[Item]) -> float:
    """F1 at the class level averaged over true names, so that rare ones count."""
    # a name inside the true class is the true name here
    pairs = [(item.label, item.label if item.first in item.accepted else item.first) for item in items]
    scores = []
    for name in sorted({true for true, _ in pairs}):
        hits = sum(true == said == name for true, said in pairs)
        total = sum(true == name for true, _ in pairs) + sum(said == name for _, said in pairs)
        scores.append(2.0 * hits / total)
    return float(np.mean(scores)) if scores else float("nan")
