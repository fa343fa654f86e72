"""The latent trajectory of a chart, most visible coordinate first."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lagsplat.chart.chart import Chart
from lagsplat.report.style import ENCODED, INPUTS, MARK, PAGE_IN, PREDICTED, new_figure, paper_style

BINS = 700
CLOSE_UP_S = 10.0


def visibility_order(metric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates by decreasing share of the metric's trace, and these shares in the same order."""
    share = np.diag(metric) / np.trace(metric)
    order = np.argsort(-share, kind="stable")
    return order, share[order]


def draw_latents(chart: Chart, *, title: str, input_names: tuple[str, ...] = ()) -> Figure:
    """Each whitened coordinate over the whole recording and, on the right, ten seconds around the split.

    Long series are drawn as the range within each of 700 bins. Panels carry the coordinate's share of the
    visibility metric's trace; the split between training and held-out frames is marked.
    """
    order, share = visibility_order(chart.metric)
    time_s = chart.time_s - chart.time_s[0]
    split_s = float(time_s[min(chart.n_train, len(time_s) - 1)])
    near = np.abs(time_s - split_s) <= 0.5 * CLOSE_UP_S
    rows = chart.d + int(chart.inputs.shape[1] > 0)
    with paper_style():
        figure = new_figure(PAGE_IN, 0.55 + 0.62 * rows, title=title)
        axes = figure.subplots(rows, 2, sharex="col", squeeze=False, width_ratios=[2.2, 1])
        for row, (index, part) in enumerate(zip(order, share, strict=True)):
            series = chart.latents[:, index]
            whole, close = axes[row]
            for stretch, colour, name in (
                (slice(None, chart.n_train), ENCODED, "training"),
                (slice(chart.n_train, None), PREDICTED, "held out"),
            ):
                _range(whole, time_s[stretch], series[stretch], colour, name)
            for stretch, colour in ((time_s < split_s, ENCODED), (time_s >= split_s, PREDICTED)):
                close.plot(time_s[near & stretch], series[near & stretch], color=colour)
            whole.set_ylabel(f"$q_{{{index + 1}}}$")
            whole.set_title(f"{100 * part:.1f} % of tr G", loc="right", pad=2)
        if chart.inputs.shape[1]:
            names = input_names or tuple(f"u{i + 1}" for i in range(chart.inputs.shape[1]))
            for column, name in enumerate(names):
                colour = INPUTS[column % len(INPUTS)]
                _range(axes[-1, 0], time_s, chart.inputs[:, column], colour, name)
                axes[-1, 1].plot(time_s[near], chart.inputs[near, column], color=colour, label=name)
            axes[-1, 0].set_ylabel("inputs")
            axes[-1, 1].legend(
                ncols=4, loc="lower right", bbox_to_anchor=(1.0, 0.95), handlelength=1.0, columnspacing=0.8
            )
        for axis in axes.ravel():
            axis.axvline(split_s, color=MARK, linewidth=0.8, linestyle="--")
        axes[0, 0].legend(loc="upper left", ncols=2, handlelength=1.0, bbox_to_anchor=(0.0, 1.35))
        axes[-1, 0].set_xlabel("time (s)")
        axes[-1, 1].set_xlabel("time (s), around the split")
        figure.align_ylabels(axes[:, 0])
    return figure


def _range(axis: Any, time_s: np.ndarray, series: np.ndarray, colour: str, label: str) -> None:
    """A line, or the range within bins where a line would only be a smear."""
    if len(series) <= 2 * BINS:
        axis.plot(time_s, series, color=colour, label=label)
        return
    edges = np.linspace(0, len(series), BINS + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(series, edges), np.maximum.reduceat(series, edges)
    axis.fill_between(time_s[edges], low, high, color=colour, alpha=0.75, linewidth=0.2, label=label)
