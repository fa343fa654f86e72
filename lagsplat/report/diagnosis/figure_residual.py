"""At which frequencies the residual acts, and what it goes with there.

A diagnosis along time: the residual of a whole file, and a stretch of it with both forecasts.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lagsplat.diagnose.core.result import Block, Diagnosis
from lagsplat.report.common.formatting import format_number, format_percent
from lagsplat.report.common.style import (
    ENCODED,
    INPUTS,
    MARK,
    PAGE_IN,
    PREDICTED,
    QUIET,
    label_decades,
    new_figure,
    paper_style,
)
from lagsplat.report.diagnosis.content import find_main_coordinate, get_location
from lagsplat.report.diagnosis.summary import name_second_forecast

MAX_CURVES = 6  # curves of coherence
STYLES = ("-", (0, (5, 1)), (0, (1, 1)), (0, (4, 1, 1, 1)), (0, (2, 1)), (0, (6, 2)))


def draw_spectrum(diagnosis: Diagnosis) -> Figure | None:
    """Power of the residual with bands and lines, its coherence with inputs and velocities; None without."""
    found = get_location(diagnosis.where, "spectrum")
    if found is None:
        return None
    at = find_coordinate_index(diagnosis)
    with paper_style():
        figure = new_figure(PAGE_IN, 2.1, title="")
        power, coherence = figure.subplots(1, 2)
        _power(power, found, at, get_coordinate_name(diagnosis, at))
        _coherence(coherence, found, at)
        for axis in (power, coherence):
            axis.set_xscale("log")
            axis.set_xlim(found.frequency_hz[0], found.frequency_hz[-1])
            label_decades(axis.xaxis)
            axis.set_xlabel("frequency (Hz)")
        return figure


def _power(axis: Any, found: Any, at: int, name: str) -> None:
    label: str | None = "bands with their share"
    for low, high, share in found.bands:
        axis.axvspan(low, high, color=EVENT_COLOUR, alpha=0.45, linewidth=0, zorder=0, label=label)
        axis.annotate(
            f"{100 * share:.0f} %", (np.sqrt(low * high), 0.99), xycoords=("data", "axes fraction"),
            ha="center", va="top", fontsize=6,
        )  # fmt: skip
        label = None
    others: str | None = "of the others"
    for i in range(found.power.shape[1]):
        if found.power[:, i].max() > 0.0:
            color, width = (ENCODED, 1.0) if i == at else (QUIET, 0.5)
            shown = f"residual of {name}" if i == at else others
            others = others if i == at else None
            axis.plot(found.frequency_hz, found.power[:, i], color=color, linewidth=width, label=shown)
    for line in found.lines:
        axis.axvline(line.frequency_hz, color=MARK, linestyle=":")
        axis.annotate(
            f"{format_number(line.frequency_hz)} Hz", (line.frequency_hz, 0.03), (2, 0), rotation=90, fontsize=6,
            xycoords=("data", "axes fraction"), textcoords="offset points", color=MARK,
        )  # fmt: skip
    if (found.power > 0.0).any():
        axis.set_yscale("log")
        label_decades(axis.yaxis)
        axis.set_ylim(top=3.0 * found.power.max())
    axis.set_ylabel("power over the swing's (1/Hz)")
    _spectrum_legend(axis, 3)


def _coherence(axis: Any, found: Any, at: int) -> None:
    height = found.coherence[:, at].max(axis=0, initial=0.0)
    kept = sorted(np.argsort(height)[::-1][:MAX_CURVES])
    for i, column in enumerate(kept):
        axis.plot(
            found.frequency_hz, found.coherence[:, at, column], color=INPUTS[i % len(INPUTS)],
            linestyle=STYLES[i % len(STYLES)], label=_called(found.names[column]),
        )  # fmt: skip
    axis.axhline(found.significant, color="black", linewidth=0.5, linestyle="--")
    axis.annotate(
        "1 in 100 by chance", (0.01, found.significant), (0, 1), va="bottom", fontsize=6,
        xycoords=("axes fraction", "data"), textcoords="offset points",
    )  # fmt: skip
    axis.set(ylim=(0.0, 1.02), ylabel="coherence with")
    if kept:
        _spectrum_legend(axis, min(len(kept), 4))


def _called(name: str) -> str:
    return f"rate of {name.removeprefix('v_')}" if name.startswith("v_") else name


def _spectrum_legend(axis: Any, columns: int) -> None:
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.0)


MAX_POINTS = 3000  # of a line at most: more than a page can show
MAX_BLOCKS = 8  # held-out blocks of the stretch
EVENT_COLOUR = "#F0E442"
INK = "#222222"


def find_coordinate_index(diagnosis: Diagnosis) -> int:
    """The coordinate with the largest share of the residual; the first where none is known."""
    name = find_main_coordinate(diagnosis.where)
    return diagnosis.q_names.index(name) if name in diagnosis.q_names else 0


def get_coordinate_name(diagnosis: Diagnosis, number: int) -> str:
    """Its name."""
    return diagnosis.q_names[number] if number < len(diagnosis.q_names) else f"q{number}"


def draw_time_strip(diagnosis: Diagnosis) -> Figure | None:
    """Residual over one file, then measured and forecast motion of a stretch; None without either."""
    at = find_coordinate_index(diagnosis)
    smoothed = _smoothed(diagnosis)
    blocks = _stretch(diagnosis, None if smoothed is None else smoothed.motion.source)
    if smoothed is None and not blocks:
        return None
    rows = [name for name, there in (("whole", smoothed), ("motion", blocks), ("near", smoothed)) if there]
    if "motion" not in rows:
        rows = ["whole"]
    with paper_style():
        figure = new_figure(PAGE_IN, 0.35 + 1.2 * len(rows), title="")
        axes = dict(zip(rows, np.atleast_1d(figure.subplots(len(rows), 1)), strict=True))
        name = get_coordinate_name(diagnosis, at)
        span = _span(blocks)
        if "whole" in axes:
            _residual(axes["whole"], smoothed, at, name)
            axes["whole"].margins(y=0.16)
            _events(axes["whole"], diagnosis, smoothed.motion.source)
            _time_legend(axes["whole"])
            if "near" in axes:
                for edge in span:
                    axes["whole"].axvline(edge, color=INK, linestyle=":", linewidth=0.7)
        if "motion" in axes:
            _motions(axes["motion"], blocks, at, (name, name_second_forecast(diagnosis)))
            axes["motion"].set_xlim(*span)
            if "near" in axes:
                axes["motion"].tick_params(labelbottom=False)
        if "near" in axes:
            _residual(axes["near"], smoothed, at, name, span=span)
            axes["near"].set_xlim(*span)
        list(axes.values())[-1].set_xlabel(f"time in {_source(smoothed, blocks)} (s)")
        figure.align_ylabels(list(axes.values()))
        return figure


def _span(blocks: Sequence[Block]) -> tuple[float, float]:
    return (float(blocks[0].time_s[0]), float(blocks[-1].time_s[-1])) if blocks else (0.0, 0.0)


def _smoothed(diagnosis: Diagnosis) -> Any:
    """The file in which most of the residual was found."""
    several = get_location(diagnosis.where, "smoothed") or ()
    told = get_location(diagnosis.where, "time_s") or ()
    first = next((one for one in several if told and one.motion.source == told[0][0]), None)
    return first if first is not None else next(iter(several), None)


def _stretch(diagnosis: Diagnosis, source: str | None) -> list[Block]:
    """Blocks that follow one another, about the one that the sim forecasts worst."""
    blocks = [one for one in diagnosis.blocks if source is None or one.file == source]
    blocks = blocks or list(diagnosis.blocks)
    if not blocks:
        return []
    blocks = [one for one in blocks if one.file == blocks[0].file]
    blocks.sort(key=lambda one: float(one.time_s[0]))
    errors = [np.nan_to_num(np.mean((one.sim - one.real) ** 2), nan=np.inf) for one in blocks]
    first = min(max(int(np.argmax(errors)) - MAX_BLOCKS // 2, 0), max(len(blocks) - MAX_BLOCKS, 0))
    return blocks[first : first + MAX_BLOCKS]


def _source(smoothed: Any, blocks: Sequence[Block]) -> str:
    name = smoothed.motion.source if smoothed is not None else blocks[0].file
    return str(name).replace("\\", "/").rpartition("/")[2]


def _residual(axis: Any, one: Any, at: int, name: str, span: tuple[float, float] | None = None) -> None:
    time_s, residual, std = one.motion.time_s, one.residual[:, at], one.std[:, at]
    inside = np.ones(len(time_s), dtype=bool) if span is None else (time_s >= span[0]) & (time_s <= span[1])
    stride = max(1, int(inside.sum()) // MAX_POINTS)
    for start, stop in one.motion.segments:
        part = np.arange(start, stop)[inside[start:stop]][::stride]
        if not len(part):
            continue
        label = "residual acceleration, ±2 σ" if start == 0 and span is None else None
        low, high = residual[part] - 2 * std[part], residual[part] + 2 * std[part]
        axis.fill_between(time_s[part], low, high, color=ENCODED, alpha=0.3, linewidth=0)
        axis.plot(time_s[part], residual[part], color=ENCODED, label=label)
    axis.axhline(0.0, color=INK, linewidth=0.5)
    if span is None:
        axis.set_xlim(time_s[0], time_s[-1])
    axis.set_ylabel(f"real − sim\n({name}/s²)")


def _events(axis: Any, diagnosis: Diagnosis, source: str) -> None:
    label: str | None = "events, with their share"
    for file, start, end, share in get_location(diagnosis.where, "time_s") or ():
        if file != source:
            continue
        axis.axvspan(start, end, color=EVENT_COLOUR, alpha=0.45, linewidth=0, zorder=0, label=label)
        middle = 0.5 * (start + end)
        axis.annotate(
            format_percent(share),
            (middle, 0.97),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=6,
        )
        label = None


def _motions(axis: Any, blocks: Sequence[Block], at: int, names: tuple[str, str]) -> None:
    for number, one in enumerate(blocks):
        labels = ("measured", "sim", names[1]) if number == 0 else (None, None, None)
        axis.plot(one.time_s, one.real[:, at], color=INK, linewidth=1.6, alpha=0.35, label=labels[0])
        axis.plot(one.time_s, one.sim[:, at], color=PREDICTED, linestyle=(0, (4, 1.5)), label=labels[1])
        axis.plot(one.time_s, one.augmented[:, at], color=ENCODED, label=labels[2])
        axis.axvline(one.time_s[0], color=QUIET, linewidth=0.4)
    real = np.concatenate([one.real[:, at] for one in blocks])
    room = 0.6 * max(np.ptp(real), 1e-12)
    # A forecast that runs away must not flatten the motion.
    axis.set_ylim(real.min() - room, real.max() + room)
    axis.set_ylabel(names[0])
    _time_legend(axis)


def _time_legend(axis: Any) -> None:
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=3, borderaxespad=0.0)


def draw_forecast_comparison(diagnosis: Diagnosis) -> Figure | None:
    """Forecasts of the worst, the median and the best block: of the sim, and of the sim with effects."""
    blocks = [one for one in diagnosis.blocks if len(one.time_s) > 1]
    if not blocks:
        return None
    at = find_coordinate_index(diagnosis)
    scale = float(np.std(np.concatenate([one.real[:, at] for one in blocks]))) or 1.0
    order = sorted(blocks, key=lambda one: -_miss(one, "sim", at, scale))
    picked = [order[0], order[len(order) // 2], order[-1]] if len(order) > 2 else order
    with paper_style():
        figure = new_figure(PAGE_IN, 0.4 + 1.0 * len(picked), title="")
        axes = figure.subplots(len(picked), 2, sharey="row", squeeze=False)
        for row, one in zip(axes, picked, strict=True):
            low, high = one.real[:, at].min(), one.real[:, at].max()
            room = 0.4 * max(high - low, 1e-12)
            for axis, kind, color in zip(row, ("sim", "augmented"), (PREDICTED, ENCODED), strict=True):
                axis.plot(one.time_s, one.real[:, at], color=INK, linewidth=1.6, alpha=0.35, label="measured")
                axis.plot(one.time_s, getattr(one, kind)[:, at], color=color, label="forecast")
                axis.set_title(f"off by {format_percent(_miss(one, kind, at, scale))}", loc="right", pad=1)
                axis.set_title(f"block {one.index}", loc="left", pad=1)
                axis.set(xlim=(one.time_s[0], one.time_s[-1]), ylim=(low - room, high + room))
            row[0].set_ylabel(get_coordinate_name(diagnosis, at))
        for axis, title in zip(axes[-1], ("sim as delivered", name_second_forecast(diagnosis)), strict=True):
            axis.set_xlabel(f"time (s) · {title}")
        axes[0, 0].legend(loc="best", ncols=1)
        return figure


def _miss(one: Block, kind: str, at: int, scale: float) -> float:
    off = getattr(one, kind)[:, at] - one.real[:, at]
    return float(np.nan_to_num(np.sqrt(np.mean(off**2)) / scale, nan=np.inf))
