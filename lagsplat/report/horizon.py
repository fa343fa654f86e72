"""The image error of every model along the same long rollouts."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from lagsplat.report.style import INPUTS, PAGE_IN, PREDICTED, QUIET, new_figure, paper_style

COLOURS = (PREDICTED, *INPUTS[:4], INPUTS[5])


def draw_horizon(models: Sequence[tuple[str, Mapping[str, Any]]], *, title: str) -> Figure:
    """Median error over time with the band of the central two thirds of the starts, for each named model.

    ``models`` are names with the results of `lagsplat.evaluate.horizon.error_along`, all from the same
    starts. The grey lines are what holding the first frame and the mean frame would give.

    Raises:
        ValueError: no model has such rollouts, or they began at different frames.
    """
    drawn = [(name, found) for name, found in models if "reason" not in found]
    if not drawn:
        reason = next((found["reason"] for _, found in models), "no model was given")
        raise ValueError(f"nothing to draw: {reason}")
    if len({str(found["starts"]) for _, found in drawn}) > 1:
        raise ValueError("the models were started at different frames; evaluate all with the same settings")
    with paper_style():
        figure = new_figure(PAGE_IN, 2.8, title=title)
        axis = figure.subplots()
        for (name, found), colour in zip(drawn, COLOURS, strict=False):
            axis.fill_between(
                found["time_s"], found["low"], found["high"], color=colour, alpha=0.15, linewidth=0
            )
            axis.plot(found["time_s"], found["median"], color=colour, label=name)
        _, any_model = drawn[0]
        for key, style, label in (("hold", "--", "first frame held"), ("mean_frame", ":", "mean frame")):
            axis.plot(any_model["time_s"], any_model[key], color=QUIET, linestyle=style, label=label)
        axis.set(yscale="log", xlabel="time since the start [s]", ylabel="mean squared image error")
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
