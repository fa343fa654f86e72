"""The residual over time and over frequency, and held-out forecasts beside the measurement."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lagsplat.diagnose.core.result import Block, Diagnosis
from lagsplat.report.common import style
from lagsplat.report.common.formatting import format_number, format_percent
from lagsplat.report.diagnosis.content import find_main_coordinate, read_location
from lagsplat.report.diagnosis.summary import name_second_forecast

MAX_CURVES = 6  # curves of coherence
LINE_STYLES = ("-", (0, (5, 1)), (0, (1, 1)), (0, (4, 1, 1, 1)), (0, (2, 1)), (0, (6, 2)))
MAX_POINTS = 3000  # of a line at most: more than a page can show
MAX_BLOCKS = 8  # held-out blocks of the stretch
EVENT_COLOUR = "#F0E442"


@style.paper_style()
def draw_spectrum(diagnosis: Diagnosis) -> Figure | None:
    """Draw the residual's power and its coherence with inputs and velocities; None without a spectrum."""
    spectrum = read_location(diagnosis).get("spectrum")
    if spectrum is None:
        return None
    coordinate = find_coordinate_index(diagnosis)
    figure = style.new_figure(style.PAGE_IN, 2.1)
    power, coherence = figure.subplots(1, 2)
    _draw_power(power, spectrum, coordinate, diagnosis.q_names[coordinate])
    _draw_coherence(coherence, spectrum, coordinate)
    for axis in (power, coherence):
        axis.set_xscale("log")
        axis.set_xlim(spectrum.frequency_hz[0], spectrum.frequency_hz[-1])
        style.label_decades(axis.xaxis)
        axis.set_xlabel("frequency (Hz)")
    return figure


def _draw_power(axis: Any, spectrum: Any, coordinate: int, name: str) -> None:
    for i, (low, high, share) in enumerate(spectrum.bands):
        label = "bands with their share" if i == 0 else None
        _shade(axis, low, high, (np.sqrt(low * high), 0.99), f"{100 * share:.0f} %", label)
    others: str | None = "of the others"
    for i, power in enumerate(spectrum.power.T):
        if power.max() <= 0.0:
            continue
        if i == coordinate:
            label = f"residual of {name}"
            axis.plot(spectrum.frequency_hz, power, color=style.ENCODED, linewidth=1.0, label=label)
        else:
            axis.plot(spectrum.frequency_hz, power, color=style.QUIET, linewidth=0.5, label=others)
            others = None
    for line in spectrum.lines:
        axis.axvline(line.frequency_hz, color=style.MARK, linestyle=":")
        text, place = f"{format_number(line.frequency_hz)} Hz", (line.frequency_hz, 0.03)
        style.annotate(
            axis, text, place, (2, 0), xycoords=style.ALONG_X, rotation=90, fontsize=6, color=style.MARK_WORDS
        )
    if (spectrum.power > 0.0).any():
        axis.set_yscale("log")
        style.label_decades(axis.yaxis)
        axis.set_ylim(top=3.0 * spectrum.power.max())
    axis.set_ylabel("power over the swing's (1/Hz)")
    style.place_legend_above(axis, 3)


def _shade(
    axis: Any, low: float, high: float, place: tuple[float, float], share: str, label: str | None
) -> None:
    """Shade a span of an axis, and write its share at a place of the upper edge."""
    axis.axvspan(low, high, color=EVENT_COLOUR, alpha=0.45, linewidth=0, zorder=0, label=label)
    style.annotate(axis, share, place, xycoords=style.ALONG_X, ha="center", va="top", fontsize=6)


def _draw_coherence(axis: Any, spectrum: Any, coordinate: int) -> None:
    height = spectrum.coherence[:, coordinate].max(axis=0, initial=0.0)
    columns = sorted(np.argsort(height)[::-1][:MAX_CURVES])
    for i, column in enumerate(columns):
        name = spectrum.names[column]
        axis.plot(
            spectrum.frequency_hz,
            spectrum.coherence[:, coordinate, column],
            color=style.INPUTS[i],
            linestyle=LINE_STYLES[i],
            label=f"rate of {name.removeprefix('v_')}" if name.startswith("v_") else name,
        )
    axis.axhline(spectrum.significant, color="black", linewidth=0.5, linestyle="--")
    place = (0.01, spectrum.significant)
    style.annotate(axis, "1 in 100 by chance", place, (0, 1), xycoords=style.ALONG_Y, va="bottom", fontsize=6)
    axis.set(ylim=(0.0, 1.02), ylabel="coherence with")
    if columns:
        style.place_legend_above(axis, min(len(columns), 4))


def find_coordinate_index(diagnosis: Diagnosis) -> int:
    """Find the coordinate with the largest share of the residual; the first where none is known."""
    name = find_main_coordinate(diagnosis)
    return diagnosis.q_names.index(name) if name in diagnosis.q_names else 0


@style.paper_style()
def draw_time_strip(diagnosis: Diagnosis) -> Figure | None:
    """Draw the residual over one file, and measured and forecast motion of a stretch; None without either."""
    coordinate = find_coordinate_index(diagnosis)
    name = diagnosis.q_names[coordinate]
    smoothed = _select_smoothed(diagnosis)
    blocks = _select_blocks(diagnosis, None if smoothed is None else smoothed.motion.source)
    if smoothed is None and not blocks:
        return None
    source = blocks[0].file if smoothed is None else smoothed.motion.source
    rows = 3 if smoothed is not None and blocks else 1
    figure = style.new_figure(style.PAGE_IN, 0.35 + 1.2 * rows)
    axes = np.atleast_1d(figure.subplots(rows, 1))
    if smoothed is not None:
        whole = (smoothed.motion.time_s[0], smoothed.motion.time_s[-1])
        _draw_residual(axes[0], smoothed, coordinate, name, whole, "residual acceleration, ±2 σ")
        axes[0].margins(y=0.16)
        _draw_events(axes[0], diagnosis, source)
        style.place_legend_above(axes[0], 3, 0.99)
    if blocks:
        span = (blocks[0].time_s[0], blocks[-1].time_s[-1])
        motion = axes[rows // 2]
        _draw_motions(motion, blocks, coordinate, name, name_second_forecast(diagnosis))
        motion.set_xlim(*span)
        if smoothed is not None:
            for edge in span:
                axes[0].axvline(edge, color=style.INK, linestyle=":", linewidth=0.7)
            motion.tick_params(labelbottom=False)
            _draw_residual(axes[2], smoothed, coordinate, name, span, None)
    axes[-1].set_xlabel(f"time in {os.path.basename(source)} (s)")
    figure.align_ylabels(list(axes))
    return figure


def _select_smoothed(diagnosis: Diagnosis) -> Any:
    """The file in which most of the residual was found."""
    location = read_location(diagnosis)
    files, events = location.get("smoothed") or (), location.get("time_s") or ()
    eventful = [file for file in files if events and file.motion.source == events[0][0]]
    return next(iter([*eventful, *files]), None)


def _select_blocks(diagnosis: Diagnosis, source: str | None) -> list[Block]:
    """Blocks that follow one another, about the one that the sim forecasts worst."""
    blocks = [block for block in diagnosis.blocks if block.file == source] or list(diagnosis.blocks)
    if not blocks:
        return []
    blocks = [block for block in blocks if block.file == blocks[0].file]
    blocks.sort(key=lambda block: float(block.time_s[0]))
    errors = [np.nan_to_num(np.mean((block.sim - block.real) ** 2), nan=np.inf) for block in blocks]
    first = min(max(int(np.argmax(errors)) - MAX_BLOCKS // 2, 0), max(len(blocks) - MAX_BLOCKS, 0))
    return blocks[first : first + MAX_BLOCKS]


def _draw_residual(
    axis: Any, smoothed: Any, coordinate: int, name: str, span: tuple[float, float], label: str | None
) -> None:
    time_s = smoothed.motion.time_s
    residual, std = smoothed.residual[:, coordinate], smoothed.std[:, coordinate]
    inside = (time_s >= span[0]) & (time_s <= span[1])
    stride = max(1, int(inside.sum()) // MAX_POINTS)
    for start, stop in smoothed.motion.segments:
        part = np.arange(start, stop)[inside[start:stop]][::stride]
        if not len(part):
            continue
        low, high = residual[part] - 2 * std[part], residual[part] + 2 * std[part]
        axis.fill_between(time_s[part], low, high, color=style.ENCODED, alpha=0.3, linewidth=0)
        axis.plot(time_s[part], residual[part], color=style.ENCODED, label=label if start == 0 else None)
    axis.axhline(0.0, color=style.INK, linewidth=0.5)
    axis.set_xlim(*span)
    axis.set_ylabel(f"real − sim\n({name}/s²)")


def _draw_events(axis: Any, diagnosis: Diagnosis, source: str) -> None:
    events = read_location(diagnosis).get("time_s") or ()
    spans = [(start, end, share) for file, start, end, share in events if file == source]
    for i, (start, end, share) in enumerate(spans):
        label = "events, with their share" if i == 0 else None
        _shade(axis, start, end, (0.5 * (start + end), 0.97), format_percent(share), label)


def _draw_motions(axis: Any, blocks: Sequence[Block], coordinate: int, name: str, second: str) -> None:
    for number, block in enumerate(blocks):
        labels = ("measured", "sim", second) if number == 0 else (None, None, None)
        real, sim, augmented = (x[:, coordinate] for x in (block.real, block.sim, block.augmented))
        _plot_measured(axis, block.time_s, real, labels[0])
        axis.plot(block.time_s, sim, color=style.PREDICTED, linestyle=(0, (4, 1.5)), label=labels[1])
        axis.plot(block.time_s, augmented, color=style.ENCODED, label=labels[2])
        axis.axvline(block.time_s[0], color=style.QUIET, linewidth=0.4)
    real = np.concatenate([block.real[:, coordinate] for block in blocks])
    margin = 0.6 * max(np.ptp(real), 1e-12)
    # A forecast that diverges must not flatten the motion.
    axis.set_ylim(real.min() - margin, real.max() + margin)
    axis.set_ylabel(name)
    style.place_legend_above(axis, 3, 0.99)


def _plot_measured(axis: Any, time_s: np.ndarray, real: np.ndarray, label: str | None) -> None:
    axis.plot(time_s, real, color=style.INK, linewidth=1.6, alpha=0.35, label=label)


@style.paper_style()
def draw_forecast_comparison(diagnosis: Diagnosis) -> Figure | None:
    """Draw the worst, the median and the best block: forecasts of the sim, and of the sim with effects."""
    blocks = [block for block in diagnosis.blocks if len(block.time_s) > 1]
    if not blocks:
        return None
    coordinate = find_coordinate_index(diagnosis)
    scale = float(np.std(np.concatenate([block.real[:, coordinate] for block in blocks]))) or 1.0

    def measure_error(block: Block, kind: str) -> float:
        error = getattr(block, kind)[:, coordinate] - block.real[:, coordinate]
        return float(np.nan_to_num(np.sqrt(np.mean(error**2)) / scale, nan=np.inf))

    kinds = {"sim": style.PREDICTED, "augmented": style.ENCODED}
    order = sorted(blocks, key=lambda block: -measure_error(block, "sim"))
    rows = [order[0], order[len(order) // 2], order[-1]] if len(order) > 2 else order
    figure = style.new_figure(style.PAGE_IN, 0.4 + 1.0 * len(rows))
    axes = figure.subplots(len(rows), 2, sharey="row", squeeze=False)
    for row, block in zip(axes, rows, strict=True):
        real = block.real[:, coordinate]
        margin = 0.4 * max(np.ptp(real), 1e-12)
        for axis, (kind, color) in zip(row, kinds.items(), strict=True):
            _plot_measured(axis, block.time_s, real, "measured")
            axis.plot(block.time_s, getattr(block, kind)[:, coordinate], color=color, label="forecast")
            axis.set_title(f"off by {format_percent(measure_error(block, kind))}", loc="right", pad=1)
            axis.set_title(f"block {block.index}", loc="left", pad=1)
            axis.set_xlim(block.time_s[0], block.time_s[-1])
            axis.set_ylim(real.min() - margin, real.max() + margin)
        row[0].set_ylabel(diagnosis.q_names[coordinate])
    for axis, title in zip(axes[-1], ("sim as delivered", name_second_forecast(diagnosis)), strict=True):
        axis.set_xlabel(f"time (s) · {title}")
    axes[0, 0].legend(loc="best", ncols=1)
    return figure
