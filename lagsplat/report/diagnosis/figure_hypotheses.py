"""Which effects explain the gap, how far they close it, and how well the recording distinguishes them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lagsplat.diagnose.core.result import Diagnosis, Gap
from lagsplat.diagnose.effects.registry import VERDICTS, short_title
from lagsplat.diagnose.inference.profile_likelihood import ProfileLikelihood
from lagsplat.report.common import formatting, style
from lagsplat.report.common.formatting import format_number, format_percent, format_probability
from lagsplat.report.diagnosis.content import ReportContent, compute_remaining, read_location
from lagsplat.report.diagnosis.summary import name_candidate, select_chosen

SEPARABLE_FROM = 3.0  # nats from which two effects are distinguishable
INTERVAL_DROP = 1.353  # nats at the ends of a 90 % interval
MAX_PROFILES = 6
LOG_AXIS_RATIO = 20.0  # from the smallest to the largest value: then the axis is logarithmic
MAX_DROP = 12.0  # nats shown
MAX_BARS = 12
LABEL: dict[str, Any] = {"ha": "center", "bbox": {"facecolor": "white", "edgecolor": "none", "pad": 0.8}}
"""Of a bar, which keeps a line behind it from crossing it."""
TERM_TITLES = {
    "inertial": "inertial (mass)",
    "conservative": "conservative (springs, weight)",
    "dissipative": "dissipative (friction, drag)",
    "actuation": "actuation (inputs)",
    "exogenous": "exogenous (from outside)",
    "memory": "memory (of the past)",
    "unexplained": "unknown",
}


@style.paper_style()
def draw_error_budget(content: ReportContent) -> Figure | None:
    """Draw the error of each stage over its floor, with its 95 % interval; None without a floor."""
    stages = [stage for stage in content.stages if stage.floor is not None and stage.floor > 0.0]
    if not stages:
        return None
    figure = style.new_figure(style.PAGE_IN, 0.55 + 0.24 * len(stages))
    axis = figure.subplots()
    for row, stage in enumerate(stages):
        value, low, high = (x / stage.floor for x in (stage.value, stage.low, stage.high))
        axis.plot(
            [1.0, value], [row, row], color=style.QUIET, linewidth=4.0, alpha=0.35, solid_capstyle="butt"
        )
        axis.plot([low, high], [row, row], color=style.INK, linewidth=1.0)
        axis.plot(value, row, "o", color=style.PREDICTED, markersize=4.5)
        text = f"{format_number(stage.value)} over a floor of {format_number(stage.floor)}"
        style.annotate(axis, text, (1.01, row), xycoords=style.ALONG_Y, va="center", fontsize=6.5)
    axis.axvline(1.0, color=style.MARK, linestyle="--")
    axis.set_yticks(range(len(stages)), [stage.name for stage in stages])
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    axis.xaxis.set_minor_formatter(lambda x, _: f"{x:g}" if f"{x:.0e}"[0] in "25" else "")
    axis.set(ylim=(len(stages) - 0.5, -0.5), xlabel="error in multiples of its floor (dashed)")
    return figure


@style.paper_style()
def draw_waterfall(diagnosis: Diagnosis) -> Figure | None:
    """Draw the gap of the sim as delivered, what a refit and the effects take away, and the floor."""
    gap = diagnosis.gap
    if gap is None:
        return None
    bars = [("refit within\nuncertainty", gap.refit, "#56B4E9")] if math.isfinite(gap.refit) else []
    if diagnosis.combination:
        names = [_wrap_label(f"+ {name_candidate(effect)}") for effect in select_chosen(diagnosis)]
        bars.append(("\n".join(names), gap.after, style.ENCODED))
    lines = max((label.count("\n") for label, _, _ in bars), default=1)
    figure = style.new_figure(0.75 * style.PAGE_IN, 2.0 + 0.12 * lines)
    axis = figure.subplots()
    axis.bar(0, gap.before, color=style.QUIET, width=0.6)
    style.annotate(axis, format_percent(gap.before), (0, gap.before), (0, 3), **LABEL)
    level = gap.before
    for column, (_, value, color) in enumerate(bars, start=1):
        axis.bar(column, value - level, bottom=level, color=color, width=0.6)
        axis.plot([column - 0.7, column + 0.3], [level, level], color=style.INK, linewidth=0.5)
        style.annotate(axis, f"to {format_percent(value)}", (column, max(level, value)), (0, 3), **LABEL)
        level = value
    last = len(bars) + 1
    axis.bar(last, gap.after, color=style.PREDICTED, width=0.6)
    axis.plot([last - 0.7, last + 0.3], [level, level], color=style.INK, linewidth=0.5)
    top = _draw_remaining_interval(axis, last, gap)
    style.annotate(axis, format_percent(gap.after), (last, top), (0, 3), **LABEL)
    labels = ["sim as\ndelivered", *(label for label, _, _ in bars), "what\nremains"]
    axis.set_xticks(range(last + 1), labels)
    if math.isfinite(gap.floor):
        axis.axhline(gap.floor, color=style.MARK, linestyle="--")
        text, place = f"floor {format_percent(gap.floor)}", (1.0, gap.floor)
        style.annotate(axis, text, place, (2, 0), xycoords=style.ALONG_Y, va="center", color=style.MARK_WORDS)
    axis.set_ylim(0.0, 1.12 * max(gap.before, top, *(value for _, value, _ in bars)))
    axis.yaxis.set_major_formatter(lambda y, _: f"{100 * y:g} %")
    axis.set_ylabel("gap (share of rms)")
    return figure


def _draw_remaining_interval(axis: Any, column: int, gap: Gap) -> float:
    """Draw the interval of what remains, from that of the closure, and return its upper end."""
    left = compute_remaining(gap, gap.closure)
    if left.low is None or left.high is None:
        return gap.after
    axis.plot([column, column], [left.low, left.high], color=style.INK, linewidth=1.0)
    return max(left.high, gap.after)


def _wrap_label(text: str) -> str:
    """Break the line before the place, so that neighbours do not touch."""
    for word in (" at ", " of "):
        head, separator, tail = text.rpartition(word)
        if separator:
            return f"{head}\n{separator.strip()} {tail}"
    return text


@style.paper_style()
def draw_separability(content: ReportContent) -> Figure | None:
    """Draw by how many nats the recording distinguishes two effects; None where not computed."""
    separability = content.separability
    if separability is None:
        return None
    n = len(separability.names)
    names = [short_title(name) for name in separability.names]
    figure = style.new_figure(min(style.PAGE_IN, 2.6 + 0.42 * n), 1.3 + 0.24 * n)
    nats = np.where(np.eye(n, dtype=bool), np.nan, separability.nats)
    shown = np.log10(np.clip(nats, 0.1, 1e3))
    ticks = {-1: "≤ 0.1", 0: "1", 1: "10", 2: "100", 3: "≥ 1000"}
    axis = _draw_matrix(figure, shown, names, names, "nats; framed: not distinguishable (< 3)", ticks)
    for i, j in np.argwhere(np.isfinite(nats)):
        color = "white" if shown[i, j] < 1.0 else "black"
        text = format_number(float(nats[i, j]))
        axis.text(j, i, text, ha="center", va="center", fontsize=6, color=color)
        if nats[i, j] < SEPARABLE_FROM:
            corner, edge = (j - 0.46, i - 0.44), style.PREDICTED
            axis.add_patch(Rectangle(corner, 0.92, 0.88, fill=False, edgecolor=edge, linewidth=1.3))
    return figure


@style.paper_style()
def draw_residual_correlations(content: ReportContent) -> Figure | None:
    """Draw tests of the residual against its possible drivers, over their 5 % bounds; None without any."""
    correlations = content.correlations
    if correlations is None:
        return None
    score, names = correlations.score, (correlations.coordinates, correlations.regressors)
    height_in, width_in = 0.95 + 0.24 * score.shape[0], 1.8 + 0.36 * score.shape[1]
    figure = style.new_figure(min(style.PAGE_IN, width_in), height_in)
    shown = np.log2(np.clip(score, 0.25, 16.0))
    ticks = {-2: "≤ ¼", 0: "1", 2: "4", 4: "≥ 16"}
    axis = _draw_matrix(figure, shown, *names, "statistic over\nits 5 % bound", ticks)
    for i, j in np.argwhere(score > 1.0):
        axis.plot(j, i, "o", color="white", markeredgecolor="black", markersize=4.0, markeredgewidth=0.6)
    return figure


def _draw_matrix(
    figure: Figure,
    values: np.ndarray,
    rows: Sequence[str],
    columns: Sequence[str],
    label: str,
    ticks: Mapping[int, str],
) -> Any:
    """Draw a matrix in colours from the first to the last tick, with names at its sides; return its axis."""
    axis = figure.subplots()
    low, high = min(ticks), max(ticks)
    image = axis.imshow(np.ma.masked_invalid(values), cmap="cividis", vmin=low, vmax=high, aspect="auto")
    axis.set_xticks(range(len(columns)), columns, rotation=35, ha="right", rotation_mode="anchor")
    axis.set_yticks(range(len(rows)), rows)
    axis.spines[:].set_visible(False)
    axis.tick_params(length=0)
    bar = style.add_colorbar(figure, image, axis, label)
    bar.set_ticks(list(ticks), labels=list(ticks.values()))
    return axis


@style.paper_style()
def draw_profiles(diagnosis: Diagnosis, content: ReportContent) -> Figure | None:
    """Draw the likelihood along each parameter with its 90 % interval; None where not computed."""
    shown = content.profiles[:MAX_PROFILES]
    if not shown:
        return None
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = style.new_figure(style.PAGE_IN * columns / 3.0, 0.15 + 1.55 * rows)
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axis, profile in zip(axes.flat, shown, strict=False):
        _draw_profile(axis, diagnosis, profile)
    for axis in axes.flat[len(shown) :]:
        axis.set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel("log-likelihood\nbelow its best (nat)")
    return figure


def _draw_profile(axis: Any, diagnosis: Diagnosis, profile: ProfileLikelihood) -> None:
    fall = profile.log_likelihood - np.max(profile.log_likelihood)
    if np.min(profile.values) > 0.0 and np.max(profile.values) > LOG_AXIS_RATIO * np.min(profile.values):
        axis.set_xscale("log")
        style.label_decades(axis.xaxis)
    axis.plot(profile.values, fall, "o-", color=style.ENCODED, markersize=2.5)
    axis.axhline(-INTERVAL_DROP, color=style.QUIET, linestyle="--", linewidth=0.6)
    for candidate in [*select_chosen(diagnosis), *diagnosis.candidates]:
        fitted = candidate.parameters.get(profile.parameter) if candidate.name == profile.effect else None
        if fitted is not None and len(formatting.list_numbers(fitted.value)) == 1:
            value, low, high = (formatting.list_numbers(x) for x in (fitted.value, fitted.low, fitted.high))
            if low and high:
                axis.axvspan(low[0], high[0], color=style.PREDICTED, alpha=0.2, linewidth=0)
            axis.axvline(value[0], color=style.PREDICTED)
            break
    unit = formatting.format_unit(profile.unit)
    axis.set_xlabel(profile.parameter.replace("_", " ") + (f" ({unit})" if unit else ""))
    axis.set_title(short_title(profile.effect), loc="left", pad=2)
    axis.set_ylim(max(-MAX_DROP, 1.1 * float(np.min(fall))) - 0.1, 0.5)


@style.paper_style()
def draw_components(diagnosis: Diagnosis) -> Figure | None:
    """Draw the probability of a cause by the kind of term that it changes; None where not computed."""
    shares = read_location(diagnosis).get("components")
    if not shares:
        return None
    names = [name for name in TERM_TITLES if name in shares]
    figure = style.new_figure(0.6 * style.PAGE_IN, 0.5 + 0.17 * len(names))
    axis = figure.subplots()
    largest = max(shares, key=lambda name: shares[name])
    for row, name in enumerate(names):
        share = shares[name]
        _draw_bar(axis, row, share, chosen=name == largest, other=name == "unexplained")
        style.annotate(axis, format_percent(share), (max(share, 0.0), row), (3, 0), va="center")
    axis.set_yticks(range(len(names)), [TERM_TITLES[name] for name in names])
    axis.set(ylim=(len(names) - 0.4, -0.6), xlim=(0.0, 1.1), xlabel="probability, given a cause")
    axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
    return figure


def _draw_bar(axis: Any, row: int, share: float, *, chosen: bool, other: bool) -> None:
    """Draw a bar: orange if it is chosen, grey and hatched if it is something other than an explanation."""
    color = style.QUIET if other else style.PREDICTED if chosen else style.ENCODED
    axis.barh(row, share, color=color, height=0.7, edgecolor="w", hatch="////" if other else None)


@style.paper_style()
def draw_posterior(diagnosis: Diagnosis) -> Figure:
    """Draw the probability and the log evidence of every candidate, `none` and `unknown` included."""
    candidates = diagnosis.candidates
    shown = [c for number, c in enumerate(candidates) if number < MAX_BARS or c.name in VERDICTS]
    left = len(candidates) - len(shown)
    rest = sum(c.probability for c in candidates) - sum(c.probability for c in shown)
    rows = len(shown) + bool(left)
    figure = style.new_figure(style.PAGE_IN, 0.5 + 0.17 * rows)
    axis = figure.subplots()
    for row, candidate in enumerate(shown):
        share, chosen = candidate.probability, candidate.name in diagnosis.combination
        _draw_bar(axis, row, share, chosen=chosen, other=candidate.name in VERDICTS)
        style.annotate(axis, format_probability(share), (share, row), (3, 0), va="center")
        known = math.isfinite(candidate.log_evidence) and candidate.name != "none"
        sign = "+" if candidate.log_evidence > 0 else ""
        text = f"{sign}{format_number(candidate.log_evidence)}" if known else "–"
        if candidate.misfit is None and candidate.name not in VERDICTS:
            text = "not fitted"
        style.annotate(axis, text, (1.12, row), xycoords=style.ALONG_Y, va="center", ha="right")
    if left:
        axis.barh(len(shown), rest, color=style.ENCODED, alpha=0.4, height=0.7)
        style.annotate(axis, format_probability(rest), (rest, len(shown)), (3, 0), va="center")
    head, place = "log evidence\nover none (nat)", (1.12, 1.0)
    style.annotate(axis, head, place, (0, 2), xycoords="axes fraction", ha="right", va="bottom", fontsize=6.0)
    others = [f"{left} others together"] if left else []
    axis.set_yticks(range(rows), [*(name_candidate(candidate) for candidate in shown), *others])
    axis.set(ylim=(rows - 0.4, -0.6), xlim=(0.0, 1.05), xlabel="probability")
    return figure
