"""Figures and tables of a score: confusion matrix, reliability, risk against coverage, CSV."""

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
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
LAST = ("none", "unknown")  # rows and columns after those of effects
DARK = 0.6  # share of a row from which a number is white
SIGMAS = 1.96  # of a normal, on each side of 95 %
NUMBERS = (
    ("brier_class", "Brier score"),
    ("macro_f1", "macro F1"),
)


@contextmanager
def _looks() -> Iterator[None]:
    """The style sheet of all figures: type and lines alone, no code of what is judged."""
    with style.context("lagsplat.report.common.templates.paper"):
        yield


def _save(figure: Figure, out: Path, name: str) -> None:
    dates: dict[str, dict[str, None]] = {"pdf": {"CreationDate": None}, "png": {}}
    for suffix, metadata in dates.items():
        figure.savefig(out / f"{name}.{suffix}", bbox_inches="tight", metadata=metadata)


def _rows(items: list[Item]) -> list[Item]:
    """Recordings with one effect or none of which something was said."""
    return [i for i in items if i.kind != "pair" and i.said.verdict != "missing"]


def _named(item: Item) -> str:
    """What was named first; a right class counts under the true name."""
    return item.label if item.first in item.accepted else item.first


@_looks()
def confusion(items: list[Item], out: Path) -> None:
    """True against first-ranked name, a right class counted under the true one; shades: shares of a row."""
    rows = _rows(items)
    true, said = [i.label for i in rows], [_named(i) for i in rows]
    names = sorted(set(true) | set(said), key=lambda name: (name in LAST, name))
    at = {name: k for k, name in enumerate(names)}
    table = np.zeros((len(names), len(names)))
    for a, b in zip(true, said, strict=True):
        table[at[a], at[b]] += 1
    total = table.sum(1, keepdims=True)
    share = table / np.maximum(total, 1)
    right = np.eye(len(names), dtype=bool)
    size = 1.9 + 0.135 * len(names)
    figure = Figure(figsize=(size, size))
    axes = figure.subplots()
    for chosen, colours in ((right, "Blues"), (~right, "Oranges")):
        axes.imshow(np.where(chosen & (table > 0), share, np.nan), cmap=colours, vmin=0.0, vmax=1.2)
    for i, j in np.argwhere(table):
        ink = "white" if share[i, j] > DARK else "black"
        axes.text(j, i, int(table[i, j]), ha="center", va="center", color=ink, fontsize=5.5)
    labels = [name.replace("_", " ") for name in names]
    counts = [f"{label} ({int(n)})" for label, n in zip(labels, total[:, 0], strict=True)]
    axes.set_xticks(range(len(names)), labels, rotation=90)
    axes.set_yticks(range(len(names)), counts)
    axes.set_xticks(np.arange(len(names) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(names) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="#E6E6E6", linewidth=0.4)
    axes.tick_params(which="both", length=0)
    axes.set_axisbelow(True)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("named first")
    axes.set_ylabel("true effect (number of recordings)")
    hits = int(np.trace(table))
    axes.set_title(
        f"{hits} of {len(rows)} recordings named rightly (blue); shade: share of the row", loc="left"
    )
    _save(figure, out, "confusion")


@_looks()
def reliability(curve: list[tuple[float, float, int]], error: float, out: Path) -> None:
    """Share right against stated probability over bins of equal mass, with intervals and counts."""
    figure = Figure(figsize=(3.4, 3.4))
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="#7F7F7F", linewidth=0.8, linestyle="--", label="as stated")
    for stated, right, n in curve:
        axes.plot([stated, stated], _interval(right, n), color="#0072B2", linewidth=0.6, alpha=0.5)
    stated, right = [c for c, _, _ in curve], [a for _, a, _ in curve]
    counts = [n for _, _, n in curve]
    few = f"{min(counts)}" if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"
    label = f"{few} recordings each, 95 % interval" if counts else "no recording"
    axes.plot(stated, right, "o", color="#0072B2", label=label)
    axes.set(
        xlabel="stated probability of the first name", ylabel="share right", xlim=(0, 1.02), ylim=(0, 1.02)
    )
    axes.set_aspect("equal")
    axes.legend(loc="upper left")
    axes.set_title(f"expected calibration error {error:.3f} over {sum(counts)} recordings", loc="left")
    _save(figure, out, "calibration")


def _interval(share: float, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    middle, spread = share + SIGMAS**2 / (2 * n), share * (1.0 - share) / n + SIGMAS**2 / (4 * n**2)
    reach = SIGMAS * float(np.sqrt(spread))
    return (middle - reach) / (1.0 + SIGMAS**2 / n), (middle + reach) / (1.0 + SIGMAS**2 / n)


@_looks()
def risk(items: list[Item], out: Path) -> None:
    """Share wrong among the answered against the share answered."""
    rows = _rows(items)
    coverage, wrong = risk_coverage(rows)
    figure = Figure(figsize=(3.4, 2.8))
    axes = figure.subplots()
    axes.step(100.0 * coverage, 100.0 * wrong, where="post", color="#0072B2")
    axes.set_xlabel(f"answered, most probable first (% of {len(rows)} recordings)")
    axes.set_ylabel("wrong among them (%)")
    axes.set(xlim=(0.0, 100.0), ylim=(0.0, None))
    if len(rows):
        axes.set_title(f"{100.0 * wrong[-1]:.0f} % wrong if all are answered", loc="left")
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
