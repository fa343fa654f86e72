"""Figures and tables of a score: confusion matrix, reliability, risk against coverage, CSV."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.gapgen.metrics import Item, risk_coverage

ROWS = (
    ("top1_class", "top-1, class"),
    ("top2_class", "top-2, class"),
    ("top1_class_predicted", "top-1, class, where it predicts"),
    ("top1_family", "top-1, family"),
    ("false_alarms", "false alarms"),
    ("abstention_outside", "abstention, outside"),
    ("abstention_left_out", "abstention, left out"),
    ("false_abstention", "false abstention"),
    ("unnamed_outside", "unnamed, outside"),
    ("unnamed", "wrongly unnamed"),
    ("wrong_names", "recordings with a wrong or invented name"),
)
NUMBERS = (
    ("brier_class", "Brier score"),
    ("macro_f1", "macro F1"),
)


def _save(figure: Figure, out: Path, name: str) -> None:
    for suffix in ("pdf", "png"):
        figure.savefig(out / f"{name}.{suffix}", dpi=160, bbox_inches="tight")


def confusion(items: list[Item], out: Path) -> None:
    """True against first-ranked name, a right class counted under the true name; rows sum to one."""
    rows = [i for i in items if i.kind != "pair" and i.said.verdict != "missing"]
    true = [i.label for i in rows]
    said = [i.label if i.first in i.accepted else i.first for i in rows]
    names = sorted(set(true) | set(said))
    at = {name: k for k, name in enumerate(names)}
    table = np.zeros((len(names), len(names)))
    for a, b in zip(true, said, strict=True):
        table[at[a], at[b]] += 1
    total = table.sum(1, keepdims=True)
    with mpl.rc_context({"font.size": 7}):
        size = 2.0 + 0.24 * len(names)
        figure = Figure(figsize=(size, size))
        axes = figure.subplots()
        axes.imshow(table / np.maximum(total, 1), cmap="Greys", vmin=0.0, vmax=1.0)
        for i, j in np.argwhere(table):
            dark = table[i, j] > 0.5 * total[i, 0]
            axes.text(j, i, int(table[i, j]), ha="center", va="center", color="white" if dark else "black")
        labels = [name.replace("_", " ") for name in names]
        axes.set_xticks(range(len(names)), labels, rotation=90)
        axes.set_yticks(range(len(names)), labels)
        axes.set_xlabel("named first")
        axes.set_ylabel("true")
        _save(figure, out, "confusion")


def reliability(curve: list[tuple[float, float, int]], error: float, out: Path) -> None:
    """Accuracy against stated probability over bins of equal mass."""
    figure = Figure(figsize=(3.2, 3.0))
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1.0)
    axes.plot([c for c, _, _ in curve], [a for _, a, _ in curve], "o-", color="C0", markersize=4)
    axes.set_xlabel("stated probability")
    axes.set_ylabel("share right")
    axes.set_title(f"expected calibration error {error:.3f}", fontsize=9)
    _save(figure, out, "calibration")


def risk(items: list[Item], out: Path) -> None:
    """Share wrong among the answered against the share answered."""
    coverage, wrong = risk_coverage([i for i in items if i.kind != "pair" and i.said.verdict != "missing"])
    figure = Figure(figsize=(3.2, 3.0))
    axes = figure.subplots()
    axes.plot(coverage, wrong, color="C0")
    axes.set_xlabel("share answered")
    axes.set_ylabel("share wrong among them")
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(0.0, 1.0)
    _save(figure, out, "risk_coverage")


def _cell(found: Any) -> str:
    """A number or a share with its interval; empty where there is none."""
    if isinstance(found, dict) and "low" in found:
        if not found["n"]:
            return ""
        return f"{found['value']:.2f} [{found['low']:.2f}, {found['high']:.2f}] n={found['n']}"
    if isinstance(found, dict):
        return f"{found['median']:.3f} (p10 {found['p10']:.3f}) n={found['n']}" if found["n"] else ""
    return "" if found is None or found != found else f"{found:.2f}"


def _counted(value: float, n: int) -> str:
    """A number and how many recordings it is over."""
    return f"{value:.3f} n={n}" if n else ""


def lines_of(
    scores: dict[str, dict[str, Any] | None],
) -> list[tuple[str, list[str]]]:
    """The rows of a table: a label, and for each method its cell."""

    def row(label: str, *path: str) -> tuple[str, list[str]]:
        cells = []
        for one in scores.values():
            found: Any = one
            for key in path:
                found = found.get(key) if found is not None else None
            cells.append(_cell(found))
        return label, cells

    def counted(label: str, count: Callable[[dict[str, Any]], tuple[float, int]]) -> Any:
        return label, [_counted(*count(one)) if one is not None else _cell(None) for one in scores.values()]

    shares = relative_wrong_names(scores)
    label = "wrong names over those of the best baseline"
    return [
        *(row(label, key) for key, label in ROWS),
        (label, [_cell(share) for share in shares]),
        counted("calibration error", lambda one: (one["ece_class"], one["calibrated"])),
        counted("two effects, set F1", lambda one: (one["set_f1_class"]["mean"], one["set_f1_class"]["n"])),
        *(row(label, key) for key, label in NUMBERS),
        row("closure over oracle, median", "closure_over_oracle"),
        *(row(f"where: {key}", "where", key) for key in ("level", "component", "coordinate")),
        row("parameter error, median", "parameters", "relative_error"),
        row("90 % interval covers", "parameters", "coverage"),
    ]


def relative_wrong_names(scores: dict[str, dict[str, Any] | None]) -> list[float | None]:
    """Each method's share of recordings with a wrong name over that of the best baseline.

    The best baseline names the most single effects right; without one, or where it names nothing wrongly,
    there is no ratio.
    """
    others = {name: one for name, one in scores.items() if name != "diagnosis" and one is not None}
    right = {name: one["top1_class"]["value"] for name, one in others.items() if one["top1_class"]["n"]}
    if not right:
        return [None] * len(scores)
    best = max(right, key=lambda name: right[name])
    least = others[best]["wrong_names"]["value"]
    return [
        None if one is None or not least else one["wrong_names"]["value"] / least for one in scores.values()
    ]


def table(scores: dict[str, dict[str, Any]], out: Path) -> None:
    """``table.csv``: metrics down, methods across."""
    with (out / "table.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["metric", *scores])
        writer.writerows([label, *cells] for label, cells in lines_of(dict(scores)))
