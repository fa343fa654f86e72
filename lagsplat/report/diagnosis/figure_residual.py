"""The residual over time and over frequency, and held-out forecasts beside the measurement."""

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
    annotate,
    label_decades,
    new_figure,
    paper_style,
    place_legend_above,
)
from lagsplat.report.diagnosis.content import find_main_coordinate, get_location
from lagsplat.report.diagnosis.summary import name_second_forecast

MAX_CURVES = 6  # curves of coherence
LINE_STYLES = ("-", (0, (5, 1)), (0, (1, 1)), (0, (4, 1, 1, 1)), (0, (2, 1)), (0, (6, 2)))
MAX_POINTS = 3000  # of a line at most: more than a page can show
MAX_BLOCKS = 8  # held-out blocks of the stretch
EVENT_COLOUR = "#F0E442"
INK = "#222222"


def draw_spectrum(diagnosis: Diagnosis) -> Figure | None:
    """Draw the residual's power and its coherence with inputs and velocities; None without a spectrum."""
    spectrum = get_location(diagnosis.where, "spectrum")
    if spectrum is None:
        return None
    coordinate = find_coordinate_index(diagnosis)
    with paper_style():
        figure = new_figure(PAGE_IN, 2.1, title="")
        power, coherence = figure.subplots(1, 2)
        _draw_power(power, spectrum, coordinate, get_coordinate_name(diagnosis, coordinate))
        _draw_coherence(coherence, spectrum, coordinate)
        for axis in (power, coherence):
            axis.set_xscale("log")
            axis.set_xlim(spectrum.frequency_hz[0], spectrum.frequency_hz[-1])
            label_decades(axis.xaxis)
            axis.set_xlabel("frequency (Hz)")
        return figure


def _draw_power(axis: Any, spectrum: Any, coordinate: int, name: str) -> None:
    label: str | None = "bands with their share"
    for low, high, share in spectrum.bands:
        axis.axvspan(low, high, color=EVENT_COLOUR, alpha=0.45, linewidth=0, zorder=0, label=label)
        annotate(
            axis,
            f"{100 * share:.0f} %",
            (np.sqrt(low * high), 0.99),
            at=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=6,
        )
        label = None
    others: str | None = "of the others"
    for i in range(spectrum.power.shape[1]):
        if spectrum.power[:, i].max() > 0.0:
            color, width = (ENCODED, 1.0) if i == coordinate else (QUIET, 0.5)
            text = f"residual of {name}" if i == coordinate else others
            others = others if i == coordinate else None
            axis.plot(spectrum.frequency_hz, spectrum.power[:, i], color=color, linewidth=width, label=text)
    for line in spectrum.lines:
        axis.axvline(line.frequency_hz, color=MARK, linestyle=":")
        annotate(
            axis,
            f"{format_number(line.frequency_hz)} Hz",
            (line.frequency_hz, 0.03),
            at=("data", "axes fraction"),
            offset=(2, 0),
            rotation=90,
            fontsize=6,
            color=MARK,
        )
    if (spectrum.power > 0.0).any():
        axis.set_yscale("log")
        label_decades(axis.yaxis)
        axis.set_ylim(top=3.0 * spectrum.power.max())
    axis.set_ylabel("power over the swing's (1/Hz)")
    place_legend_above(axis, 3)


def _draw_coherence(axis: Any, spectrum: Any, coordinate: int) -> None:
    height = spectrum.coherence[:, coordinate].max(axis=0, initial=0.0)
    kept = sorted(np.argsort(height)[::-1][:MAX_CURVES])
    for i, column in enumerate(kept):
        axis.plot(
            spectrum.frequency_hz,
            spectrum.coherence[:, coordinate, column],
            color=INPUTS[i % len(INPUTS)],
            linestyle=LINE_STYLES[i % len(LINE_STYLES)],
            label=_name_regressor(spectrum.names[column]),
        )
    axis.axhline(spectrum.significant, color="black", linewidth=0.5, linestyle="--")
    annotate(
        axis,
        "1 in 100 by chance",
        (0.01, spectrum.significant),
        at=("axes fraction", "data"),
        offset=(0, 1),
        va="bottom",
        fontsize=6,
    )
    axis.set(ylim=(0.0, 1.02), ylabel="coherence with")
    if kept:
        place_legend_above(axis, min(len(kept), 4))


def _name_regressor(name: str) -> str:
    return f"rate of {name.removeprefix('v_')}" if name.startswith("v_") else name


def find_coordinate_index(diagnosis: Diagnosis) -> int:
    """Find the coordinate with the largest share of the residual; the first where none is known."""
    name = find_main_coordinate(diagnosis.where)
    return diagnosis.q_names.index(name) if name in diagnosis.q_names else 0


def get_coordinate_name(diagnosis: Diagnosis, index: int) -> str:
    """Get the name of a coordinate."""
    return diagnosis.q_names[index] if index < len(diagnosis.q_names) else f"q{index}"


def draw_time_strip(diagnosis: Diagnosis) -> Figure | None:
    """Draw the residual over one file, and measured and forecast motion of a stretch; None without either."""
    coordinate = find_coordinate_index(diagnosis)
    smoothed = _select_smoothed(diagnosis)
    blocks = _select_blocks(diagnosis, None if smoothed is None else smoothed.motion.source)
    if smoothed is None and not blocks:
        return None
    rows = [
        name for name, available in (("whole", smoothed), ("motion", blocks), ("near", smoothed)) if available
    ]
    if "motion" not in rows:
        rows = ["whole"]
    with paper_style():
        figure = new_figure(PAGE_IN, 0.35 + 1.2 * len(rows), title="")
        axes = dict(zip(rows, np.atleast_1d(figure.subplots(len(rows), 1)), strict=True))
        name = get_coordinate_name(diagnosis, coordinate)
        span = _get_span(blocks)
        if "whole" in axes:
            _draw_residual(axes["whole"], smoothed, coordinate, name)
            axes["whole"].margins(y=0.16)
            _draw_events(axes["whole"], diagnosis, smoothed.motion.source)
            place_legend_above(axes["whole"], 3, 0.99)
            if "near" in axes:
                for edge in span:
                    axes["whole"].axvline(edge, color=INK, linestyle=":", linewidth=0.7)
        if "motion" in axes:
            _draw_motions(axes["motion"], blocks, coordinate, (name, name_second_forecast(diagnosis)))
            axes["motion"].set_xlim(*span)
            if "near" in axes:
                axes["motion"].tick_params(labelbottom=False)
        if "near" in axes:
            _draw_residual(axes["near"], smoothed, coordinate, name, span=span)
            axes["near"].set_xlim(*span)
        list(axes.values())[-1].set_xlabel(f"time in {_get_source(smoothed, blocks)} (s)")
        figure.align_ylabels(list(axes.values()))
        return figure


def _get_span(blocks: Sequence[Block]) -> tuple[float, float]:
    return (float(blocks[0].time_s[0]), float(blocks[-1].time_s[-1])) if blocks else (0.0, 0.0)


def _select_smoothed(diagnosis: Diagnosis) -> Any:
    """The file in which most of the residual was found."""
    several = get_location(diagnosis.where, "smoothed") or ()
    events = get_location(diagnosis.where, "time_s") or ()
    first = next((file for file in several if events and file.motion.source == events[0][0]), None)
    return first if first is not None else next(iter(several), None)


def _select_blocks(diagnosis: Diagnosis, source: str | None) -> list[Block]:
    """Blocks that follow one another, about the one that the sim forecasts worst."""
    blocks = [block for block in diagnosis.blocks if source is None or block.file == source]
    blocks = blocks or list(diagnosis.blocks)
    if not blocks:
        return []
    blocks = [block for block in blocks if block.file == blocks[0].file]
    blocks.sort(key=lambda block: float(block.time_s[0]))
    errors = [np.nan_to_num(np.mean((block.sim - block.real) ** 2), nan=np.inf) for block in blocks]
    first = min(max(int(np.argmax(errors)) - MAX_BLOCKS // 2, 0), max(len(blocks) - MAX_BLOCKS, 0))
    return blocks[first : first + MAX_BLOCKS]


def _get_source(smoothed: Any, blocks: Sequence[Block]) -> str:
    name = smoothed.motion.source if smoothed is not None else blocks[0].file
    return str(name).replace("\\", "/").rpartition("/")[2]


def _draw_residual(
    axis: Any, smoothed: Any, coordinate: int, name: str, span: tuple[float, float] | None = None
) -> None:
    time_s, residual, std = (
        smoothed.motion.time_s,
        smoothed.residual[:, coordinate],
        smoothed.std[:, coordinate],
    )
    inside = np.ones(len(time_s), dtype=bool) if span is None else (time_s >= span[0]) & (time_s <= span[1])
    stride = max(1, int(inside.sum()) // MAX_POINTS)
    for start, stop in smoothed.motion.segments:
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


def _draw_events(axis: Any, diagnosis: Diagnosis, source: str) -> None:
    label: str | None = "events, with their share"
    for file, start, end, share in get_location(diagnosis.where, "time_s") or ():
        if file != source:
            continue
        axis.axvspan(start, end, color=EVENT_COLOUR, alpha=0.45, linewidth=0, zorder=0, label=label)
        middle = 0.5 * (start + end)
        annotate(
            axis,
            format_percent(share),
            (middle, 0.97),
            at=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=6,
        )
        label = None


def _draw_motions(axis: Any, blocks: Sequence[Block], coordinate: int, names: tuple[str, str]) -> None:
    for number, block in enumerate(blocks):
        labels = ("measured", "sim", names[1]) if number == 0 else (None, None, None)
        axis.plot(
            block.time_s, block.real[:, coordinate], color=INK, linewidth=1.6, alpha=0.35, label=labels[0]
        )
        axis.plot(
            block.time_s, block.sim[:, coordinate], color=PREDICTED, linestyle=(0, (4, 1.5)), label=labels[1]
        )
        axis.plot(block.time_s, block.augmented[:, coordinate], color=ENCODED, label=labels[2])
        axis.axvline(block.time_s[0], color=QUIET, linewidth=0.4)
    real = np.concatenate([block.real[:, coordinate] for block in blocks])
    margin = 0.6 * max(np.ptp(real), 1e-12)
    # A forecast that diverges must not flatten the motion.
    axis.set_ylim(real.min() - margin, real.max() + margin)
    axis.set_ylabel(names[0])
    place_legend_above(axis, 3, 0.99)


def draw_forecast_comparison(diagnosis: Diagnosis) -> Figure | None:
    """Draw the worst, the median and the best block: forecasts of the sim, and of the sim with effects."""
    blocks = [block for block in diagnosis.blocks if len(block.time_s) > 1]
    if not blocks:
        return None
    coordinate = find_coordinate_index(diagnosis)
    scale = float(np.std(np.concatenate([block.real[:, coordinate] for block in blocks]))) or 1.0
    order = sorted(blocks, key=lambda block: -_measure_error(block, "sim", coordinate, scale))
    picked = [order[0], order[len(order) // 2], order[-1]] if len(order) > 2 else order
    with paper_style():
        figure = new_figure(PAGE_IN, 0.4 + 1.0 * len(picked), title="")
        axes = figure.subplots(len(picked), 2, sharey="row", squeeze=False)
        for row, block in zip(axes, picked, strict=True):
            low, high = block.real[:, coordinate].min(), block.real[:, coordinate].max()
            margin = 0.4 * max(high - low, 1e-12)
            for axis, kind, color in zip(row, ("sim", "augmented"), (PREDICTED, ENCODED), strict=True):
                axis.plot(
                    block.time_s,
                    block.real[:, coordinate],
                    color=INK,
                    linewidth=1.6,
                    alpha=0.35,
                    label="measured",
                )
                axis.plot(block.time_s, getattr(block, kind)[:, coordinate], color=color, label="forecast")
                axis.set_title(
                    f"off by {format_percent(_measure_error(block, kind, coordinate, scale))}",
                    loc="right",
                    pad=1,
                )
                axis.set_title(f"block {block.index}", loc="left", pad=1)
                axis.set(xlim=(block.time_s[0], block.time_s[-1]), ylim=(low - margin, high + margin))
            row[0].set_ylabel(get_coordinate_name(diagnosis, coordinate))
        for axis, title in zip(axes[-1], ("sim as delivered", name_second_forecast(diagnosis)), strict=True):
            axis.set_xlabel(f"time (s) · {title}")
        axes[0, 0].legend(loc="best", ncols=1)
        return figure


def _measure_error(block: Block, kind: str, coordinate: int, scale: float) -> float:
    error = getattr(block, kind)[:, coordinate] - block.real[:, coordinate]
    return float(np.nan_to_num(np.sqrt(np.mean(error**2)) / scale, nan=np.inf))
