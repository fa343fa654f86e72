"""The ladder from picture to forecast, and the steps by which a gap closes.

Which effects a recording tells apart, what its residual goes with, how sharply it bounds numbers.

Shares of kinds of terms, and probabilities of effects.
"""

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lagsplat.diagnose.core.result import Diagnosis, Gap
from lagsplat.diagnose.effects.registry import short_title
from lagsplat.diagnose.inference.profile_likelihood import ProfileLikelihood
from lagsplat.report.common.formatting import (
    format_number,
    format_percent,
    format_probability,
    format_unit,
    list_numbers,
)
from lagsplat.report.common.style import (
    ENCODED,
    MARK,
    PAGE_IN,
    PREDICTED,
    QUIET,
    label_decades,
    new_figure,
    paper_style,
)
from lagsplat.report.diagnosis.content import ReportContent, get_location
from lagsplat.report.diagnosis.summary import name_candidate, select_chosen

INK = "#222222"


def draw_error_budget(exhibits: ReportContent) -> Figure | None:
    """Each rung's error over its floor with its 95 % interval; None without rungs that have a floor."""
    rungs = [one for one in exhibits.rungs if one.floor is not None and one.floor > 0.0]
    if not rungs:
        return None
    with paper_style():
        figure = new_figure(PAGE_IN, 0.55 + 0.24 * len(rungs), title="")
        axis = figure.subplots()
        for row, one in enumerate(rungs):
            value, low, high = (x / one.floor for x in (one.value, one.low, one.high))
            axis.plot([1.0, value], [row, row], color=QUIET, linewidth=4.0, alpha=0.35, solid_capstyle="butt")
            axis.plot([low, high], [row, row], color=INK, linewidth=1.0)
            axis.plot(value, row, "o", color=PREDICTED, markersize=4.5)
            told = f"{format_number(one.value)} over a floor of {format_number(one.floor)}"
            axis.annotate(told, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=6.5)
        axis.axvline(1.0, color=MARK, linestyle="--")
        axis.set_yticks(range(len(rungs)), [one.name for one in rungs])
        axis.set_xscale("log")
        axis.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        axis.xaxis.set_minor_formatter(lambda x, _: f"{x:g}" if _leading(x) in (2, 5) else "")
        axis.set(ylim=(len(rungs) - 0.5, -0.5), xlabel="error in multiples of its floor (dashed)")
        return figure


def draw_waterfall(diagnosis: Diagnosis, exhibits: ReportContent) -> Figure | None:
    """From the sim as delivered down to the floor: what a refit takes away, and what each effect takes."""
    gap = diagnosis.gap
    if gap is None:
        return None
    steps = _steps(diagnosis, gap, exhibits)
    with paper_style():
        lines = max(label.count("\n") for label, _ in steps) if steps else 1
        figure = new_figure(0.75 * PAGE_IN, 2.0 + 0.12 * lines, title="")
        axis = figure.subplots()
        axis.bar(0, gap.before, color=QUIET, width=0.6)
        axis.annotate(
            format_percent(gap.before), (0, gap.before), (0, 2), textcoords="offset points", ha="center"
        )
        level = gap.before
        for column, (_, value) in enumerate(steps, start=1):
            color = ENCODED if column > 1 or not math.isfinite(gap.refit) else "#56B4E9"
            axis.bar(column, value - level, bottom=level, color=color, width=0.6)
            axis.plot([column - 0.7, column + 0.3], [level, level], color=INK, linewidth=0.5)
            shift = f"{'' if value > level else '−'}{format_percent(abs(value - level))}"
            axis.annotate(shift, (column, max(level, value)), (0, 2), textcoords="offset points", ha="center")
            level = value
        last = len(steps) + 1
        axis.bar(last, gap.after, color=PREDICTED, width=0.6)
        axis.plot([last - 0.7, last + 0.3], [level, level], color=INK, linewidth=0.5)
        top = _after_bar(axis, last, gap)
        axis.annotate(format_percent(gap.after), (last, top), (0, 2), textcoords="offset points", ha="center")
        labels = ["sim as\ndelivered", *(label for label, _ in steps), "what\nremains"]
        axis.set_xticks(range(last + 1), labels)
        if math.isfinite(gap.floor):
            axis.axhline(gap.floor, color=MARK, linestyle="--")
            axis.annotate(
                f"floor {format_percent(gap.floor)}", (1.0, gap.floor), (2, 0), va="center", color=MARK,
                xycoords=("axes fraction", "data"), textcoords="offset points", annotation_clip=False,
            )  # fmt: skip
        axis.set_ylim(0.0, 1.12 * max(gap.before, top, *(value for _, value in steps)))
        axis.yaxis.set_major_formatter(lambda y, _: f"{100 * y:g} %")
        axis.set_ylabel("gap (share of rms)")
        return figure


def _leading(x: float) -> int:
    return round(x / 10.0 ** math.floor(math.log10(x)))


def _steps(diagnosis: Diagnosis, gap: Gap, exhibits: ReportContent) -> list[tuple[str, float]]:
    steps = [("refit within\nuncertainty", gap.refit)] if math.isfinite(gap.refit) else []
    if exhibits.steps:
        return steps + [(_wrapped(label), value) for label, value in exhibits.steps]
    named = [name_candidate(one) for one in select_chosen(diagnosis)] if diagnosis.combination else []
    if named:
        steps.append(("\n".join(_wrapped(f"+ {name}") for name in named), gap.after))
    return steps


def _after_bar(axis: object, column: int, gap: Gap) -> float:
    """The interval of what remains, from that of the closure; its upper end."""
    closure = gap.closure
    if closure.low is None or closure.high is None or not math.isfinite(gap.floor):
        return gap.after
    low, high = (gap.before - share * (gap.before - gap.floor) for share in (closure.high, closure.low))
    axis.plot([column, column], [max(low, 0.0), high], color=INK, linewidth=1.0)  # type: ignore[attr-defined]
    return max(high, gap.after)


def _wrapped(text: str) -> str:
    """Broken before the place, so that neighbours do not touch."""
    for word in (" at ", " of "):
        head, found, tail = text.rpartition(word)
        if found:
            return f"{head}\n{found.strip()} {tail}"
    return text


SEPARABLE_FROM = 3.0  # nats below which two effects are not told apart
INTERVAL_DROP = 1.353  # nats at the ends of a 90 % interval
COLOURS = "cividis"
MAX_PROFILES = 6  # profiles
LOG_AXIS_RATIO = 20.0  # from the smallest to the largest value: then the axis is logarithmic
MAX_DROP = 12.0  # nats shown


def draw_separability(exhibits: ReportContent) -> Figure | None:
    """How many nats tell the effect of a row from that of a column; None where not computed."""
    found = exhibits.separability
    if found is None:
        return None
    n = len(found.names)
    names = [short_title(name) for name in found.names]
    with paper_style():
        figure = new_figure(min(PAGE_IN, 2.6 + 0.42 * n), 1.3 + 0.24 * n, title="")
        axis = figure.subplots()
        nats = np.where(np.eye(n, dtype=bool), np.nan, found.nats)
        shown = np.log10(np.clip(nats, 0.1, 1e3))
        picture = axis.imshow(np.ma.masked_invalid(shown), cmap=COLOURS, vmin=-1.0, vmax=3.0, aspect="auto")
        for i, j in np.ndindex(n, n):
            if not np.isfinite(nats[i, j]):
                continue
            dark = shown[i, j] < 1.0
            axis.text(j, i, format_number(float(nats[i, j])), ha="center", va="center", fontsize=6,
                      color="white" if dark else "black")  # fmt: skip
            if nats[i, j] < SEPARABLE_FROM:
                axis.add_patch(Rectangle((j - 0.46, i - 0.44), 0.92, 0.88, fill=False, edgecolor=PREDICTED,
                                         linewidth=1.3))  # fmt: skip
        axis.set_xticks(range(n), names, rotation=35, ha="right", rotation_mode="anchor")
        axis.set_yticks(range(n), names)
        axis.spines[:].set_visible(False)
        axis.tick_params(length=0)
        bar = figure.colorbar(picture, ax=axis, pad=0.01, ticks=[-1, 0, 1, 2, 3])
        bar.ax.set_yticklabels(["≤ 0.1", "1", "10", "100", "≥ 1000"])
        bar.set_label("nats; framed: not told apart (< 3)")
        bar.outline.set_linewidth(0.5)
        return figure


def draw_residual_correlations(exhibits: ReportContent) -> Figure | None:
    """Tests of the residual against what may drive it, over their 5 % bounds; None where not computed."""
    found = exhibits.fingerprint
    if found is None:
        return None
    with paper_style():
        rows, columns = found.score.shape
        figure = new_figure(min(PAGE_IN, 1.8 + 0.36 * columns), 0.95 + 0.24 * rows, title="")
        axis = figure.subplots()
        shown = np.log2(np.clip(found.score, 0.25, 16.0))
        picture = axis.imshow(shown, cmap=COLOURS, vmin=-2.0, vmax=4.0, aspect="auto")
        for i, j in np.argwhere(found.score > 1.0):
            axis.plot(j, i, "o", color="white", markeredgecolor="black", markersize=4.0, markeredgewidth=0.6)
        axis.set_xticks(
            range(columns), list(found.regressors), rotation=35, ha="right", rotation_mode="anchor"
        )
        axis.set_yticks(range(rows), list(found.coordinates))
        axis.spines[:].set_visible(False)
        axis.tick_params(length=0)
        bar = figure.colorbar(picture, ax=axis, pad=0.01, ticks=[-2, 0, 2, 4])
        bar.ax.set_yticklabels(["≤ ¼", "1", "4", "≥ 16"])
        bar.set_label("statistic over\nits 5 % bound")
        bar.outline.set_linewidth(0.5)
        return figure


def draw_profiles(diagnosis: Diagnosis, exhibits: ReportContent) -> Figure | None:
    """Likelihood along each parameter with its 90 % interval; None where not computed."""
    shown = exhibits.profiles[:MAX_PROFILES]
    if not shown:
        return None
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    with paper_style():
        figure = new_figure(PAGE_IN * columns / 3.0, 0.15 + 1.55 * rows, title="")
        axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for axis, one in zip(axes.flat, shown, strict=False):
            _profile(axis, diagnosis, one)
        for axis in axes.flat[len(shown) :]:
            axis.set_visible(False)
        for row in axes:
            row[0].set_ylabel("log-likelihood\nbelow its best (nat)")
        return figure


def _profile(axis: Any, diagnosis: Diagnosis, one: ProfileLikelihood) -> None:
    fall = one.log_likelihood - np.max(one.log_likelihood)
    if np.min(one.values) > 0.0 and np.max(one.values) > LOG_AXIS_RATIO * np.min(one.values):
        axis.set_xscale("log")
        label_decades(axis.xaxis)
    axis.plot(one.values, fall, "o-", color=ENCODED, markersize=2.5)
    axis.axhline(-INTERVAL_DROP, color=QUIET, linestyle="--", linewidth=0.6)
    for candidate in [*select_chosen(diagnosis), *diagnosis.candidates]:
        fitted = candidate.parameters.get(one.parameter) if candidate.name == one.effect else None
        if fitted is not None and len(list_numbers(fitted.value)) == 1:
            low, high = list_numbers(fitted.low), list_numbers(fitted.high)
            if low and high:
                axis.axvspan(low[0], high[0], color=PREDICTED, alpha=0.2, linewidth=0)
            axis.axvline(list_numbers(fitted.value)[0], color=PREDICTED)
            break
    given = f" ({format_unit(one.unit)})" if format_unit(one.unit) else ""
    axis.set_xlabel(f"{one.parameter.replace('_', ' ')}{given}")
    axis.set_title(short_title(one.effect), loc="left", pad=2)
    axis.set_ylim(max(-MAX_DROP, 1.1 * float(np.min(fall))) - 0.1, 0.5)


MAX_BARS = 12
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
    shares = get_location(diagnosis.where, "components")
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
                format_percent(shares[name]), (max(shares[name], 0.0), row), (3, 0), textcoords="offset points",
                va="center",
            )  # fmt: skip
        axis.set_yticks(range(len(names)), [TERMS.get(name) or name for name in names])
        axis.set(ylim=(len(names) - 0.4, -0.6), xlim=(0.0, 1.1), xlabel="share of the residual's square")
        axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
        return figure


def draw_posterior(diagnosis: Diagnosis) -> Figure:
    """Probability of every candidate, `none` and `unknown` included, and its log evidence over `none`."""
    kept = list(diagnosis.candidates[:MAX_BARS])
    kept += [one for one in diagnosis.candidates[MAX_BARS:] if one.name in ("none", "unknown")]
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
            _beside(axis, row, one.probability, format_probability(one.probability))
            known = math.isfinite(one.log_evidence) and one.name != "none"
            sign = "+" if one.log_evidence > 0 else ""
            told = f"{sign}{format_number(one.log_evidence)}" if known else "–"
            axis.annotate(told, (1.12, row), xycoords=("axes fraction", "data"), va="center", ha="right")
        if left:
            axis.barh(len(kept), rest, color=ENCODED, alpha=0.4, height=0.7)
            _beside(axis, len(kept), rest, format_probability(rest))
        axis.annotate(
            "log evidence\nover none (nat)", (1.12, 1.0), (0, 2), xycoords="axes fraction", ha="right",
            textcoords="offset points", va="bottom", fontsize=6.0,
        )  # fmt: skip
        labels = [name_candidate(one) for one in kept] + ([f"{left} others together"] if left else [])
        axis.set_yticks(range(rows), labels)
        axis.set(ylim=(rows - 0.4, -0.6), xlim=(0.0, 1.05), xlabel="probability")
        return figure


def _beside(axis: object, row: int, share: float, text: str) -> None:
    axis.annotate(text, (share, row), (3, 0), textcoords="offset points", va="center")  # type: ignore[attr-defined]
