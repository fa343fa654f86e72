"""Shares of kinds of terms, and probabilities of effects."""

import math

from matplotlib.figure import Figure

from lagsplat.diagnose.result import Diagnosis
from lagsplat.report.diagnosis_names import place
from lagsplat.report.diagnosis_where import located
from lagsplat.report.rounding import number, percent, probability
from lagsplat.report.style import ENCODED, PAGE_IN, PREDICTED, QUIET, new_figure, paper_style

MOST = 12
TERMS = {
    "inertial": "inertial (mass)",
    "conservative": "conservative (springs, weight)",
    "dissipative": "dissipative (friction, drag)",
    "actuation": "actuation (inputs)",
    "exogenous": "exogenous (from outside)",
    "memory": "memory (of the past)",
    "unexplained": "unexplained",
}


def draw_components(diagnosis: Diagnosis) -> Figure | None:
    """Share of the residual that each kind of term explains; None where not computed."""
    shares = located(diagnosis.where, "components")
    if not shares:
        return None
    names: list[str] = [name for name in TERMS if name in shares]
    names += [name for name in shares if name not in TERMS]
    with paper_style():
        figure = new_figure(0.6 * PAGE_IN, 0.5 + 0.17 * len(names), title="")
        axis = figure.subplots()
        largest = max(shares, key=lambda name: shares[name])
        for row, name in enumerate(names):
            plain = name == "unexplained"
            color = QUIET if plain else PREDICTED if name == largest else ENCODED
            axis.barh(
                row, shares[name], color=color, height=0.7, hatch="////" if plain else None, edgecolor="w"
            )
            axis.annotate(
                percent(shares[name]), (max(shares[name], 0.0), row), (3, 0), textcoords="offset points",
                va="center",
            )  # fmt: skip
        axis.set_yticks(range(len(names)), [TERMS.get(name) or name for name in names])
        axis.set(ylim=(len(names) - 0.4, -0.6), xlim=(0.0, 1.1), xlabel="share of the residual's square")
        axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
        return figure


def draw_posterior(diagnosis: Diagnosis) -> Figure:
    """Probability of every candidate, `none` and `unknown` included, and its log evidence over `none`."""
    kept = list(diagnosis.candidates[:MOST])
    kept += [one for one in diagnosis.candidates[MOST:] if one.name in ("none", "unknown")]
    rest = sum(one.probability for one in diagnosis.candidates) - sum(one.probability for one in kept)
    left = len(diagnosis.candidates) - len(kept)
    named = set(diagnosis.combination)
    with paper_style():
        rows = len(kept) + bool(left)
        figure = new_figure(PAGE_IN, 0.5 + 0.17 * rows, title="")
        axis = figure.subplots()
        for row, one in enumerate(kept):
            verdict = one.name in ("none", "unknown")
            color = QUIET if verdict else PREDICTED if one.name in named else ENCODED
            axis.barh(row, one.probability, color=color, height=0.7, edgecolor="w",
                      hatch="////" if verdict else None)  # fmt: skip
            _beside(axis, row, one.probability, probability(one.probability))
            known = math.isfinite(one.log_evidence) and one.name != "none"
            sign = "+" if one.log_evidence > 0 else ""
            told = f"{sign}{number(one.log_evidence)}" if known else "–"
            axis.annotate(told, (1.12, row), xycoords=("axes fraction", "data"), va="center", ha="right")
        if left:
            axis.barh(len(kept), rest, color=ENCODED, alpha=0.4, height=0.7)
            _beside(axis, len(kept), rest, probability(rest))
        axis.annotate(
            "log evidence\nover none (nat)", (1.12, 1.0), (0, 2), xycoords="axes fraction", ha="right",
            textcoords="offset points", va="bottom", fontsize=6.0,
        )  # fmt: skip
        labels = [place(one) for one in kept] + ([f"{left} others together"] if left else [])
        axis.set_yticks(range(rows), labels)
        axis.set(ylim=(rows - 0.4, -0.6), xlim=(0.0, 1.05), xlabel="probability")
        return figure


def _beside(axis: object, row: int, share: float, text: str) -> None:
    axis.annotate(text, (share, row), (3, 0), textcoords="offset points", va="center")  # type: ignore[attr-defined]
