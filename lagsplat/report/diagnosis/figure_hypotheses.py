"""Which effects explain the gap, how far they close it, and how well the recording distinguishes them."""

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
    add_colorbar,
    annotate,
    label_decades,
    new_figure,
    paper_style,
)
from lagsplat.report.diagnosis.content import ReportContent, get_location
from lagsplat.report.diagnosis.summary import name_candidate, select_chosen

INK = "#222222"
SEPARABLE_FROM = 3.0  # nats from which two effects are distinguishable
INTERVAL_DROP = 1.353  # nats at the ends of a 90 % interval
COLOUR_MAP = "cividis"
MAX_PROFILES = 6
LOG_AXIS_RATIO = 20.0  # from the smallest to the largest value: then the axis is logarithmic
MAX_DROP = 12.0  # nats shown
MAX_BARS = 12
TERM_TITLES = {
    "inertial": "inertial (mass)",
    "conservative": "conservative (springs, weight)",
    "dissipative": "dissipative (friction, drag)",
    "actuation": "actuation (inputs)",
    "exogenous": "exogenous (from outside)",
    "memory": "memory (of the past)",
    "unexplained": "unexplained",
}


def draw_error_budget(content: ReportContent) -> Figure | None:
    """Draw the error of each stage over its floor, with its 95 % interval; None without a floor."""
    stages = [stage for stage in content.stages if stage.floor is not None and stage.floor > 0.0]
    if not stages:
        return None
    with paper_style():
        figure = new_figure(PAGE_IN, 0.55 + 0.24 * len(stages), title="")
        axis = figure.subplots()
        for row, stage in enumerate(stages):
            value, low, high = (x / stage.floor for x in (stage.value, stage.low, stage.high))
            axis.plot([1.0, value], [row, row], color=QUIET, linewidth=4.0, alpha=0.35, solid_capstyle="butt")
            axis.plot([low, high], [row, row], color=INK, linewidth=1.0)
            axis.plot(value, row, "o", color=PREDICTED, markersize=4.5)
            text = f"{format_number(stage.value)} over a floor of {format_number(stage.floor)}"
            annotate(axis, text, (1.01, row), at=("axes fraction", "data"), va="center", fontsize=6.5)
        axis.axvline(1.0, color=MARK, linestyle="--")
        axis.set_yticks(range(len(stages)), [stage.name for stage in stages])
        axis.set_xscale("log")
        axis.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        axis.xaxis.set_minor_formatter(lambda x, _: f"{x:g}" if _get_leading_digit(x) in (2, 5) else "")
        axis.set(ylim=(len(stages) - 0.5, -0.5), xlabel="error in multiples of its floor (dashed)")
        return figure


def draw_waterfall(diagnosis: Diagnosis, content: ReportContent) -> Figure | None:
    """Draw the gap of the sim as delivered, what a refit and each effect take away, and the floor."""
    gap = diagnosis.gap
    if gap is None:
        return None
    steps = _list_steps(diagnosis, gap, content)
    with paper_style():
        lines = max(label.count("\n") for label, _ in steps) if steps else 1
        figure = new_figure(0.75 * PAGE_IN, 2.0 + 0.12 * lines, title="")
        axis = figure.subplots()
        axis.bar(0, gap.before, color=QUIET, width=0.6)
        annotate(axis, format_percent(gap.before), (0, gap.before), offset=(0, 2), ha="center")
        level = gap.before
        for column, (_, value) in enumerate(steps, start=1):
            color = ENCODED if column > 1 or not math.isfinite(gap.refit) else "#56B4E9"
            axis.bar(column, value - level, bottom=level, color=color, width=0.6)
            axis.plot([column - 0.7, column + 0.3], [level, level], color=INK, linewidth=0.5)
            shift = f"{'' if value > level else '−'}{format_percent(abs(value - level))}"
            annotate(axis, shift, (column, max(level, value)), offset=(0, 2), ha="center")
            level = value
        last = len(steps) + 1
        axis.bar(last, gap.after, color=PREDICTED, width=0.6)
        axis.plot([last - 0.7, last + 0.3], [level, level], color=INK, linewidth=0.5)
        top = _draw_remaining_interval(axis, last, gap)
        annotate(axis, format_percent(gap.after), (last, top), offset=(0, 2), ha="center")
        labels = ["sim as\ndelivered", *(label for label, _ in steps), "what\nremains"]
        axis.set_xticks(range(last + 1), labels)
        if math.isfinite(gap.floor):
            axis.axhline(gap.floor, color=MARK, linestyle="--")
            annotate(
                axis,
                f"floor {format_percent(gap.floor)}",
                (1.0, gap.floor),
                at=("axes fraction", "data"),
                offset=(2, 0),
                va="center",
                color=MARK,
                annotation_clip=False,
            )
        axis.set_ylim(0.0, 1.12 * max(gap.before, top, *(value for _, value in steps)))
        axis.yaxis.set_major_formatter(lambda y, _: f"{100 * y:g} %")
        axis.set_ylabel("gap (share of rms)")
        return figure


def _get_leading_digit(x: float) -> int:
    return round(x / 10.0 ** math.floor(math.log10(x)))


def _list_steps(diagnosis: Diagnosis, gap: Gap, content: ReportContent) -> list[tuple[str, float]]:
    steps = [("refit within\nuncertainty", gap.refit)] if math.isfinite(gap.refit) else []
    if content.steps:
        return steps + [(_wrap_label(label), value) for label, value in content.steps]
    names = (
        [name_candidate(candidate) for candidate in select_chosen(diagnosis)] if diagnosis.combination else []
    )
    if names:
        steps.append(("\n".join(_wrap_label(f"+ {name}") for name in names), gap.after))
    return steps


def _draw_remaining_interval(axis: Any, column: int, gap: Gap) -> float:
    """Draw the interval of what remains, from that of the closure, and return its upper end."""
    closure = gap.closure
    if closure.low is None or closure.high is None or not math.isfinite(gap.floor):
        return gap.after
    low, high = (gap.before - share * (gap.before - gap.floor) for share in (closure.high, closure.low))
    axis.plot([column, column], [max(low, 0.0), high], color=INK, linewidth=1.0)
    return max(high, gap.after)


def _wrap_label(text: str) -> str:
    """Break the line before the place, so that neighbours do not touch."""
    for word in (" at ", " of "):
        head, separator, tail = text.rpartition(word)
        if separator:
            return f"{head}\n{separator.strip()} {tail}"
    return text


def draw_separability(content: ReportContent) -> Figure | None:
    """Draw by how many nats the recording distinguishes two effects; None where not computed."""
    separability = content.separability
    if separability is None:
        return None
    n = len(separability.names)
    names = [short_title(name) for name in separability.names]
    with paper_style():
        figure = new_figure(min(PAGE_IN, 2.6 + 0.42 * n), 1.3 + 0.24 * n, title="")
        axis = figure.subplots()
        nats = np.where(np.eye(n, dtype=bool), np.nan, separability.nats)
        shown = np.log10(np.clip(nats, 0.1, 1e3))
        image = axis.imshow(np.ma.masked_invalid(shown), cmap=COLOUR_MAP, vmin=-1.0, vmax=3.0, aspect="auto")
        for i, j in np.ndindex(n, n):
            if not np.isfinite(nats[i, j]):
                continue
            dark = shown[i, j] < 1.0
            axis.text(
                j,
                i,
                format_number(float(nats[i, j])),
                ha="center",
                va="center",
                fontsize=6,
                color="white" if dark else "black",
            )
            if nats[i, j] < SEPARABLE_FROM:
                axis.add_patch(
                    Rectangle(
                        (j - 0.46, i - 0.44), 0.92, 0.88, fill=False, edgecolor=PREDICTED, linewidth=1.3
                    )
                )
        axis.set_xticks(range(n), names, rotation=35, ha="right", rotation_mode="anchor")
        axis.set_yticks(range(n), names)
        axis.spines[:].set_visible(False)
        axis.tick_params(length=0)
        bar = add_colorbar(
            figure, image, axis, "nats; framed: not distinguishable (< 3)", ticks=[-1, 0, 1, 2, 3]
        )
        bar.ax.set_yticklabels(["≤ 0.1", "1", "10", "100", "≥ 1000"])
        bar.outline.set_linewidth(0.5)
        return figure


def draw_residual_correlations(content: ReportContent) -> Figure | None:
    """Draw tests of the residual against its possible drivers, over their 5 % bounds; None without any."""
    correlations = content.correlations
    if correlations is None:
        return None
    with paper_style():
        rows, columns = correlations.score.shape
        figure = new_figure(min(PAGE_IN, 1.8 + 0.36 * columns), 0.95 + 0.24 * rows, title="")
        axis = figure.subplots()
        shown = np.log2(np.clip(correlations.score, 0.25, 16.0))
        image = axis.imshow(shown, cmap=COLOUR_MAP, vmin=-2.0, vmax=4.0, aspect="auto")
        for i, j in np.argwhere(correlations.score > 1.0):
            axis.plot(j, i, "o", color="white", markeredgecolor="black", markersize=4.0, markeredgewidth=0.6)
        axis.set_xticks(
            range(columns), list(correlations.regressors), rotation=35, ha="right", rotation_mode="anchor"
        )
        axis.set_yticks(range(rows), list(correlations.coordinates))
        axis.spines[:].set_visible(False)
        axis.tick_params(length=0)
        bar = add_colorbar(figure, image, axis, "statistic over\nits 5 % bound", ticks=[-2, 0, 2, 4])
        bar.ax.set_yticklabels(["≤ ¼", "1", "4", "≥ 16"])
        bar.outline.set_linewidth(0.5)
        return figure


def draw_profiles(diagnosis: Diagnosis, content: ReportContent) -> Figure | None:
    """Draw the likelihood along each parameter with its 90 % interval; None where not computed."""
    shown = content.profiles[:MAX_PROFILES]
    if not shown:
        return None
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    with paper_style():
        figure = new_figure(PAGE_IN * columns / 3.0, 0.15 + 1.55 * rows, title="")
        axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for axis, profile in zip(axes.flat, shown, strict=False):
            _draw_profile(axis, diagnosis, profile)
        for axis in axes.flat[len(shown) :]:
            axis.set_visible(False)
        for row in axes:
            row[0].set_ylabel("log-likelihood\nbelow its best (nat)")
        return figure


def _draw_profile(axis: Any, diagnosis: Diagnosis, profile: ProfileLikelihood) -> None:
    fall = profile.log_likelihood - np.max(profile.log_likelihood)
    if np.min(profile.values) > 0.0 and np.max(profile.values) > LOG_AXIS_RATIO * np.min(profile.values):
        axis.set_xscale("log")
        label_decades(axis.xaxis)
    axis.plot(profile.values, fall, "o-", color=ENCODED, markersize=2.5)
    axis.axhline(-INTERVAL_DROP, color=QUIET, linestyle="--", linewidth=0.6)
    for candidate in [*select_chosen(diagnosis), *diagnosis.candidates]:
        fitted = candidate.parameters.get(profile.parameter) if candidate.name == profile.effect else None
        if fitted is not None and len(list_numbers(fitted.value)) == 1:
            low, high = list_numbers(fitted.low), list_numbers(fitted.high)
            if low and high:
                axis.axvspan(low[0], high[0], color=PREDICTED, alpha=0.2, linewidth=0)
            axis.axvline(list_numbers(fitted.value)[0], color=PREDICTED)
            break
    given = f" ({format_unit(profile.unit)})" if format_unit(profile.unit) else ""
    axis.set_xlabel(f"{profile.parameter.replace('_', ' ')}{given}")
    axis.set_title(short_title(profile.effect), loc="left", pad=2)
    axis.set_ylim(max(-MAX_DROP, 1.1 * float(np.min(fall))) - 0.1, 0.5)


def draw_components(diagnosis: Diagnosis) -> Figure | None:
    """Draw the share of the residual that each kind of term explains; None where not computed."""
    shares = get_location(diagnosis.where, "components")
    if not shares:
        return None
    names: list[str] = [name for name in TERM_TITLES if name in shares]
    names += [name for name in shares if name not in TERM_TITLES]
    with paper_style():
        figure = new_figure(0.6 * PAGE_IN, 0.5 + 0.17 * len(names), title="")
        axis = figure.subplots()
        largest = max(shares, key=lambda name: shares[name])
        for row, name in enumerate(names):
            unexplained = name == "unexplained"
            color = QUIET if unexplained else PREDICTED if name == largest else ENCODED
            axis.barh(
                row,
                shares[name],
                color=color,
                height=0.7,
                hatch="////" if unexplained else None,
                edgecolor="w",
            )
            annotate(
                axis, format_percent(shares[name]), (max(shares[name], 0.0), row), offset=(3, 0), va="center"
            )
        axis.set_yticks(range(len(names)), [TERM_TITLES.get(name) or name for name in names])
        axis.set(ylim=(len(names) - 0.4, -0.6), xlim=(0.0, 1.1), xlabel="share of the residual's square")
        axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
        return figure


def draw_posterior(diagnosis: Diagnosis) -> Figure:
    """Draw the probability and the log evidence of every candidate, `none` and `unknown` included."""
    kept = list(diagnosis.candidates[:MAX_BARS])
    kept += [
        candidate for candidate in diagnosis.candidates[MAX_BARS:] if candidate.name in ("none", "unknown")
    ]
    rest = sum(candidate.probability for candidate in diagnosis.candidates) - sum(
        candidate.probability for candidate in kept
    )
    left = len(diagnosis.candidates) - len(kept)
    named = set(diagnosis.combination)
    with paper_style():
        rows = len(kept) + bool(left)
        figure = new_figure(PAGE_IN, 0.5 + 0.17 * rows, title="")
        axis = figure.subplots()
        for row, candidate in enumerate(kept):
            verdict = candidate.name in ("none", "unknown")
            color = QUIET if verdict else PREDICTED if candidate.name in named else ENCODED
            axis.barh(
                row,
                candidate.probability,
                color=color,
                height=0.7,
                edgecolor="w",
                hatch="////" if verdict else None,
            )
            _write_beside(axis, row, candidate.probability, format_probability(candidate.probability))
            known = math.isfinite(candidate.log_evidence) and candidate.name != "none"
            sign = "+" if candidate.log_evidence > 0 else ""
            text = f"{sign}{format_number(candidate.log_evidence)}" if known else "–"
            annotate(axis, text, (1.12, row), at=("axes fraction", "data"), va="center", ha="right")
        if left:
            axis.barh(len(kept), rest, color=ENCODED, alpha=0.4, height=0.7)
            _write_beside(axis, len(kept), rest, format_probability(rest))
        annotate(
            axis,
            "log evidence\nover none (nat)",
            (1.12, 1.0),
            at="axes fraction",
            offset=(0, 2),
            ha="right",
            va="bottom",
            fontsize=6.0,
        )
        labels = [name_candidate(candidate) for candidate in kept] + (
            [f"{left} others together"] if left else []
        )
        axis.set_yticks(range(rows), labels)
        axis.set(ylim=(rows - 0.4, -0.6), xlim=(0.0, 1.05), xlabel="probability")
        return figure


def _write_beside(axis: Any, row: int, share: float, text: str) -> None:
    annotate(axis, text, (share, row), offset=(3, 0), va="center")
