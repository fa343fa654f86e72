"""Figures and tables of a score: confusion matrix, reliability, risk against coverage, CSV and LaTeX."""

import csv
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.gapgen.metrics import Item, risk_coverage

ROWS = (
    ("top1_class", "top-1, class"),
    ("top2_class", "top-2, class"),
    ("top1_family", "top-1, family"),
    ("false_alarms", "false alarms"),
    ("abstention_outside", "abstention, outside"),
    ("abstention_left_out", "abstention, left out"),
    ("false_abstention", "false abstention"),
)
NUMBERS = (
    ("ece_class", "calibration error"),
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


def _cell(found: Any) -> tuple[str, str]:
    """A number or a share with its interval, as plain text and as LaTeX."""
    if isinstance(found, dict) and "low" in found:
        if not found["n"]:
            return "", "--"
        text = f"{found['value']:.2f} [{found['low']:.2f}, {found['high']:.2f}] n={found['n']}"
        return text, f"{found['value']:.2f} [{found['low']:.2f}, {found['high']:.2f}]"
    if isinstance(found, dict):
        if not found["n"]:
            return "", "--"
        return f"{found['median']:.3f} (p10 {found['p10']:.3f}) n={found['n']}", f"{found['median']:.2f}"
    return ("", "--") if found is None or found != found else (f"{found:.3f}", f"{found:.3f}")


def lines_of(
    scores: dict[str, dict[str, Any] | None],
) -> list[tuple[str, list[tuple[str, str]]]]:
    """The rows of a table: a label, and for each method its cell as plain text and as LaTeX."""

    def row(label: str, *path: str) -> tuple[str, list[tuple[str, str]]]:
        cells = []
        for one in scores.values():
            found: Any = one
            for key in path:
                found = found.get(key) if found is not None else None
            cells.append(_cell(found))
        return label, cells

    return [
        *(row(label, key) for key, label in (*ROWS, *NUMBERS)),
        row("closure over oracle, median", "closure_over_oracle"),
        row("two effects, set F1", "set_f1_class", "mean"),
        *(row(f"where: {key}", "where", key) for key in ("level", "component", "coordinate")),
        row("parameter error, median", "parameters", "relative_error"),
        row("90 \\% interval covers", "parameters", "coverage"),
    ]


def table(scores: dict[str, dict[str, Any]], out: Path) -> None:
    """``table.csv`` and ``table.tex``: metrics down, methods across."""
    lines = lines_of(dict(scores))
    with (out / "table.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["metric", *scores])
        writer.writerows([label.replace("\\", ""), *(cell[0] for cell in cells)] for label, cells in lines)
    body = [f"{label} & " + " & ".join(cell[1] for cell in cells) + r" \\" for label, cells in lines]
    heads = " & ".join(name.replace("_", " ") for name in scores)
    tex = [
        r"\begin{tabular}{l" + "r" * len(scores) + "}",
        r"\toprule",
        f" & {heads} " + r"\\",
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
    ]
    (out / "table.tex").write_text("\n".join(tex) + "\n", encoding="utf-8")
