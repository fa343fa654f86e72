"""Curves over time and over training: image errors of rollouts, latent trajectories, losses."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lagsplat.report.common import style
from lagsplat.report.common.formatting import format_number, format_percent

if TYPE_CHECKING:  # a curve is drawn without loading torch
    from lagsplat.chart.chart import Chart

COLOURS = (style.PREDICTED, style.INPUTS[0], style.INPUTS[2], style.INPUTS[3], style.INPUTS[5], style.ENCODED)
ErrorOverTime = tuple[str, Mapping[str, Any]]
N_BINS = 700
CLOSE_UP_S = 10.0
CLOSE_UP_SHARE = 0.4  # of the recording, at most
THIN_SPACE = "\N{NARROW NO-BREAK SPACE}"


def join_seeds(seeds: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Errors of one model over time, of all its seeds: medians of the medians, and a band around every band.

    ``seeds`` are results of `lagsplat.evaluate.forecast.error_over_horizon` from the same starts. Those
    without rollouts are left out, unless none has any.

    Raises:
        ValueError: the seeds began at different frames.
    """
    drawn = [errors for errors in seeds if "reason" not in errors]
    if not drawn:
        return seeds[0]
    _require_same_starts(drawn)
    rows = {key: np.array([errors[key] for errors in drawn]) for key in ("median", "low", "high")}
    band = {"low": rows["low"].min(axis=0).tolist(), "high": rows["high"].max(axis=0).tolist()}
    return {**drawn[0], "median": np.median(rows["median"], axis=0).tolist(), **band, "seeds": len(drawn)}


def _require_same_starts(found: Sequence[Mapping[str, Any]]) -> None:
    if len({str(errors["starts"]) for errors in found}) > 1:
        raise ValueError("the models were started at different frames; evaluate all with the same settings")


def draw_horizon(ours: ErrorOverTime, peers: Mapping[str, Sequence[ErrorOverTime]], *, title: str) -> Figure:
    """Draw the median error of every model over time, a panel for each group of peers with ours in it.

    Each model is its name with the result of `lagsplat.evaluate.forecast.error_over_horizon`, all from the
    same starts, or of `join_seeds`. The band is of ours, the central two thirds of the starts of every seed;
    grey lines are what holding the first frame and the mean frame would give.

    Raises:
        ValueError: no model has such rollouts, or they began at different frames.
    """
    groups = {
        name: [model for model in (ours, *models) if "reason" not in model[1]]
        for name, models in peers.items()
    }
    groups = {name: models for name, models in groups.items() if models}
    if not groups:
        raise ValueError(f"nothing to draw: {ours[1].get('reason', 'no group of models was given')}")
    _require_same_starts([errors for models in groups.values() for _, errors in models])
    with style.paper_style():
        errors = next(iter(groups.values()))[0][1]
        over = f"{len(errors['starts'])} starts" + (
            ", then over seeds (their number in brackets)" if "seeds" in errors else ""
        )
        band = f"medians over {over}; band: central two thirds of the starts of every seed, {ours[0]}"
        figure = style.new_figure(style.PAGE_IN, 3.6, title=f"{title}\n{band}")
        axes = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
        for axis, (group, models) in zip(axes, groups.items(), strict=True):
            _draw_errors(axis, models)
            axis.set_title(group)
            axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, handlelength=2.6)
        axes[0].set_ylabel("mean squared image error (colour, 0 to 1)")
    return figure


def _draw_errors(axis: Axes, models: Sequence[ErrorOverTime]) -> None:
    _, errors = models[0]
    axis.fill_between(
        errors["time_s"], errors["low"], errors["high"], color=COLOURS[0], alpha=0.2, linewidth=0
    )
    for index, (name, found) in enumerate(models):
        colour = COLOURS[index % len(COLOURS)]  # told apart by their dashes where there are more models
        dashes = style.INPUT_DASHES[index % len(style.INPUT_DASHES)]
        label = f"{name} ({found['seeds']})" if "seeds" in found else name
        axis.plot(found["time_s"], found["median"], color=colour, linestyle=dashes, label=label)
    axis.lines[0].set(linewidth=1.6, zorder=3)
    for key, line, label in (("hold", "--", "first frame held"), ("mean_frame", ":", "mean frame")):
        axis.plot(errors["time_s"], errors[key], color=style.QUIET, linestyle=line, label=label)
    axis.set(yscale="log", xlabel="time since the start (s)", xlim=(0.0, errors["time_s"][-1]))
    style.label_decades(axis.yaxis)


VISIBILITY = "coordinates in the order of how much of the motion of the image each makes"


def describe_share(share: float) -> str:
    """Say how much of the motion of the image a coordinate makes."""
    return f"{format_percent(share)} of visible motion"


def order_by_visibility(metric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Order coordinates by the share of the visible motion that each makes, largest first, with the shares.

    That is its share of the metric's trace: the metric measures how far the image changes with the state.
    """
    share = np.diag(metric) / np.trace(metric)
    order = np.argsort(-share, kind="stable")
    return order, share[order]


def draw_latents(chart: "Chart", *, title: str) -> Figure:
    """Draw each whitened coordinate over the whole recording and, on the right, around the split.

    Long series are drawn as the range within each of 700 bins. Panels carry the share of the visible motion
    that the coordinate makes; the split between training and held-out frames is marked.
    """
    order, share = order_by_visibility(chart.metric)
    time_s = chart.time_s - chart.time_s[0]
    split_s = float(time_s[min(chart.n_train, len(time_s) - 1)])
    near = np.abs(time_s - split_s) <= 0.5 * min(CLOSE_UP_S, CLOSE_UP_SHARE * float(time_s[-1]))
    rows = chart.d + int(chart.inputs.shape[1] > 0)
    height_in = 0.75 + (1.3 if chart.d == 1 else 0.8) * rows
    with style.paper_style():
        figure = style.new_figure(
            style.PAGE_IN, height_in, title=f"{title}\n{VISIBILITY}" if chart.d > 1 else title
        )
        axes = figure.subplots(rows, 2, sharex="col", squeeze=False, width_ratios=[2.2, 1])
        for row, (index, part) in enumerate(zip(order, share, strict=True)):
            series = chart.latents[:, index]
            whole, close = axes[row]
            n = chart.n_train
            _draw_range(whole, time_s[:n], series[:n], style.ENCODED, "training")
            _draw_range(whole, time_s[n:], series[n:], style.PREDICTED, "held out")
            for stretch, colour in ((time_s < split_s, style.ENCODED), (time_s >= split_s, style.PREDICTED)):
                close.plot(time_s[near & stretch], series[near & stretch], color=colour)
            whole.set_ylabel(f"$q_{{{index + 1}}}$", rotation=0, va="center", labelpad=8)
            if chart.d > 1:
                whole.set_title(describe_share(part), loc="right", pad=2)
        above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2, "handlelength": 1.6}
        axes[0, 0].legend(ncols=2, **above)
        if chart.inputs.shape[1]:
            for column, series in enumerate(chart.inputs.T):
                look = style.distinguish(column)
                _draw_range(axes[-1, 0], time_s, series, look["color"], "")
                axes[-1, 1].plot(time_s[near], series[near], label=f"$u_{{{column + 1}}}$", **look)
            axes[-1, 0].set_ylabel("inputs")
            axes[-1, 1].legend(ncols=4, columnspacing=0.8, **above)
        for axis in axes.ravel():
            axis.axvline(split_s, color=style.MARK, linewidth=0.8, linestyle="--")
        axes[-1, 0].set_xlabel("time (s); dashed: where the held-out part begins")
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
    curve: pd.DataFrame, *, title: str, columns: Sequence[str], labels: Mapping[str, str], unit: str
) -> Figure:
    """Draw positive columns of a training curve over its first column, on a logarithmic scale.

    The legend tells where each ends; ``unit`` is that of all the errors.

    Raises:
        ValueError: a column is not in the curve.
    """
    missing = [name for name in columns if name not in curve]
    if missing:
        raise ValueError(f"the curve has no column {missing}; it has {list(curve.columns)}")
    steps = curve[curve.columns[0]]
    with style.paper_style():
        figure = style.new_figure(style.PAGE_IN, 2.6, title=title)
        axis = figure.subplots()
        for index, name in enumerate(columns):
            values = curve[name].to_numpy(dtype=float)
            positive = np.where(values > 0, values, np.nan)
            last = f", {format_number(values[-1])} in the end" if len(values) else ""
            look = style.distinguish(index)
            axis.plot(steps, positive, label=labels.get(name, name).replace("_", " ") + last, **look)
        axis.set(yscale="log", ylabel=unit)
        count = f"{steps.max() if len(steps) else 0:,.0f}".replace(",", THIN_SPACE)
        axis.set_xlabel(f"training step, of {count}")
        axis.grid(axis="y", color=style.GRID, linewidth=0.4)
        style.label_decades(axis.yaxis)
        across = len(columns) if len(columns) < 5 else 3
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=across, borderaxespad=0.2)
    return figure
