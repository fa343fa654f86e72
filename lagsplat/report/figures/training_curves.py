"""Curves over time and over training: image errors of rollouts, latent trajectories, losses."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from lagsplat.report.common import style

if TYPE_CHECKING:  # a curve is drawn without loading torch
    from lagsplat.chart.chart import Chart

COLOURS = (style.PREDICTED, *style.INPUTS[:4], style.INPUTS[5])
N_BINS = 700
CLOSE_UP_S = 10.0


def draw_horizon(models: Sequence[tuple[str, Mapping[str, Any]]], *, title: str) -> Figure:
    """Draw the median error of each model over time, with the band of the central two thirds of the starts.

    ``models`` are names with the results of `lagsplat.evaluate.forecast.error_over_horizon`, all from the
    same starts. The grey lines are what holding the first frame and the mean frame would give.

    Raises:
        ValueError: no model has such rollouts, or they began at different frames.
    """
    drawn = [(name, errors) for name, errors in models if "reason" not in errors]
    if not drawn:
        reason = next((errors["reason"] for _, errors in models), "no model was given")
        raise ValueError(f"nothing to draw: {reason}")
    if len({str(errors["starts"]) for _, errors in drawn}) > 1:
        raise ValueError("the models were started at different frames; evaluate all with the same settings")
    with style.paper_style():
        figure = style.new_figure(style.PAGE_IN, 2.8, title=title)
        axis = figure.subplots()
        for (name, errors), colour in zip(drawn, COLOURS, strict=False):
            time_s, low, high = errors["time_s"], errors["low"], errors["high"]
            axis.fill_between(time_s, low, high, color=colour, alpha=0.15, linewidth=0)
            axis.plot(time_s, errors["median"], color=colour, label=name)
        _, any_model = drawn[0]
        for key, line, label in (("hold", "--", "first frame held"), ("mean_frame", ":", "mean frame")):
            axis.plot(any_model["time_s"], any_model[key], color=style.QUIET, linestyle=line, label=label)
        axis.set(yscale="log", xlabel="time since the start [s]", ylabel="mean squared image error")
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def order_by_visibility(metric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Order coordinates by decreasing share of the metric's trace; the shares are in the same order."""
    share = np.diag(metric) / np.trace(metric)
    order = np.argsort(-share, kind="stable")
    return order, share[order]


def draw_latents(chart: "Chart", *, title: str) -> Figure:
    """Draw each whitened coordinate over the whole recording and, on the right, ten seconds around the split.

    Long series are drawn as the range within each of 700 bins. Panels carry the coordinate's share of the
    visibility metric's trace; the split between training and held-out frames is marked.
    """
    order, share = order_by_visibility(chart.metric)
    time_s = chart.time_s - chart.time_s[0]
    split_s = float(time_s[min(chart.n_train, len(time_s) - 1)])
    near = np.abs(time_s - split_s) <= 0.5 * CLOSE_UP_S
    rows = chart.d + int(chart.inputs.shape[1] > 0)
    with style.paper_style():
        figure = style.new_figure(style.PAGE_IN, 0.55 + 0.62 * rows, title=title)
        axes = figure.subplots(rows, 2, sharex="col", squeeze=False, width_ratios=[2.2, 1])
        for row, (index, part) in enumerate(zip(order, share, strict=True)):
            series = chart.latents[:, index]
            whole, close = axes[row]
            n = chart.n_train
            _draw_range(whole, time_s[:n], series[:n], style.ENCODED, "training")
            _draw_range(whole, time_s[n:], series[n:], style.PREDICTED, "held out")
            for stretch, colour in ((time_s < split_s, style.ENCODED), (time_s >= split_s, style.PREDICTED)):
                close.plot(time_s[near & stretch], series[near & stretch], color=colour)
            whole.set_ylabel(f"$q_{{{index + 1}}}$")
            whole.set_title(f"{100 * part:.1f} % of tr G", loc="right", pad=2)
        if chart.inputs.shape[1]:
            for column, series in enumerate(chart.inputs.T):
                colour, name = style.INPUTS[column % len(style.INPUTS)], f"u{column + 1}"
                _draw_range(axes[-1, 0], time_s, series, colour, name)
                axes[-1, 1].plot(time_s[near], series[near], color=colour, label=name)
            axes[-1, 0].set_ylabel("inputs")
            corner = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.95)}
            axes[-1, 1].legend(ncols=4, handlelength=1.0, columnspacing=0.8, **corner)
        for axis in axes.ravel():
            axis.axvline(split_s, color=style.MARK, linewidth=0.8, linestyle="--")
        axes[0, 0].legend(loc="upper left", ncols=2, handlelength=1.0, bbox_to_anchor=(0.0, 1.35))
        axes[-1, 0].set_xlabel("time (s)")
        axes[-1, 1].set_xlabel("time (s), around the split")
        figure.align_ylabels(axes[:, 0])
    return figure


def _draw_range(axis: Any, time_s: np.ndarray, series: np.ndarray, colour: str, label: str) -> None:
    """Draw a line, or the range within bins where a line would be a smear."""
    if len(series) <= 2 * N_BINS:
        axis.plot(time_s, series, color=colour, label=label)
        return
    edges = np.linspace(0, len(series), N_BINS + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(series, edges), np.maximum.reduceat(series, edges)
    axis.fill_between(time_s[edges], low, high, color=colour, alpha=0.75, linewidth=0.2, label=label)


def draw_curves(
    curve: pd.DataFrame, *, title: str, columns: Sequence[str], labels: Mapping[str, str]
) -> Figure:
    """Draw positive columns of a training curve over its first column, on a logarithmic scale.

    Raises:
        ValueError: a column is not in the curve.
    """
    missing = [name for name in columns if name not in curve]
    if missing:
        raise ValueError(f"the curve has no column {missing}; it has {list(curve.columns)}")
    step = curve.columns[0]
    with style.paper_style():
        figure = style.new_figure(style.PAGE_IN, 2.4, title=title)
        axis = figure.subplots()
        for name, colour in zip(columns, style.INPUTS, strict=False):
            values = curve[name].to_numpy(dtype=float)
            positive = np.where(values > 0, values, np.nan)
            axis.plot(curve[step], positive, color=colour, label=labels.get(name, name))
        axis.set(yscale="log", xlabel=step)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
