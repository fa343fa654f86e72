"""The rollout figure: latent coordinates over time above, three images and their insets below."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lagsplat.evaluate.long_rollout import LastImages, LongRollout
from lagsplat.report.common import style
from lagsplat.report.common.formatting import format_number, format_unit
from lagsplat.report.figures.training_curves import VISIBILITY, describe_share, order_by_visibility

MIN_SHIFT_PX = 0.25
ASIDE = 0.6  # share of the range of a coordinate by which a forecast may leave it within its panel
ONE_SERIES_IN, SERIES_IN, INPUTS_IN = (
    1.7,
    1.0,
    0.85,
)  # height of a panel of one coordinate, of several, of inputs
HELD_OUT_COLOUR = "#E6E6E6"


def draw_rollout(view: LongRollout, *, title: str) -> Figure:
    """Draw encoded and predicted coordinates, most visible first, and the last state as images.

    Below: the recorded image, the render at the encoded state (the image model's own floor) and at the
    predicted one, with the window where the two renders differ most in excess of the image model's error,
    magnified. The arrow gives the direction of the measured shift there, not its length. Held-out frames are
    shaded where the stretch begins with training frames.

    Source: paper, Reading the rollout figures.
    """
    d = view.encoded.shape[1]
    with style.paper_style():
        height, width = view.images.at_encoded.shape[:2]
        # three images and two square windows of one height, between two lines of title and three of numbers
        widths = [width / height] * 3 + [1.0] * 2
        top_in = (ONE_SERIES_IN if d == 1 else SERIES_IN * d) + INPUTS_IN * (view.inputs.shape[1] > 0) + 0.4
        bottom_in = 0.85 + 0.96 * style.PAGE_IN / sum(widths)
        size_in = (style.PAGE_IN, top_in + bottom_in + 0.45)
        figure = style.new_figure(*size_in, title=f"{title}\n{_describe_scores(view)}")
        above, below = figure.subfigures(2, 1, height_ratios=[top_in, bottom_in], squeeze=False)[:, 0]
        _draw_series(above, view)
        axes = below.subplots(1, 5, width_ratios=widths)
        _draw_whole_images(axes[:3], view.images, view.time_s[-1])
        _draw_windows(axes[3:], view.images)
    return figure


def _describe_scores(view: LongRollout) -> str:
    """Errors, what of the clip is held out, and what the order of the coordinates means."""
    length_s = view.time_s[-1]
    text = f"latent NRMSE {view.nrmse:.3f} over {length_s:.1f} s"
    if view.period_s is not None:
        text += f", {length_s / view.period_s:.1f} natural periods of {view.period_s:.2f} s"
    if view.held_s is None:
        text += "; the whole clip is held out"
    else:
        text += f"; {view.held_nrmse:.3f} over the held-out {length_s - view.held_s:.1f} s (shaded)"
    return text + (f"\n{VISIBILITY}" if view.encoded.shape[1] > 1 else "")


def _draw_series(figure: Any, view: LongRollout) -> None:
    order, share = order_by_visibility(view.metric)
    has_inputs = view.inputs.shape[1] > 0
    series_in = ONE_SERIES_IN if len(order) == 1 else SERIES_IN
    heights = [series_in] * len(order) + [INPUTS_IN] * has_inputs
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    dashes = {"color": style.PREDICTED, "label": "predicted", "linestyle": (0, (4, 1))}
    for axis, index, part in zip(axes, order, share, strict=False):
        encoded = view.encoded[:, index]
        axis.plot(
            view.time_s, encoded, color=style.ENCODED, label="encoded frames", linewidth=1.6, alpha=0.55
        )
        axis.plot(view.time_s, view.predicted[:, index], **dashes)
        axis.set_ylabel(f"$q_{{{index + 1}}}$", rotation=0, va="center", labelpad=8)
        if len(order) > 1:
            axis.set_title(describe_share(part), loc="right", pad=2)
        axis.set_ylim(*_choose_limits(encoded, view.predicted[:, index]))
        if view.held_s is not None:
            axis.axvspan(view.held_s, view.time_s[-1], color=HELD_OUT_COLOUR, linewidth=0, zorder=0)
        if view.lost_s is not None:
            axis.axvline(view.lost_s, color=style.MARK, linestyle=":")
    legend = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    axes[0].legend(ncols=2, **legend)
    if has_inputs:
        _draw_inputs(axes[-1], view)
        axes[-1].legend(ncols=8, columnspacing=1.0, **legend)
    diverged = "" if view.lost_s is None else f"; the rollout diverged at {view.lost_s:.1f} s (dotted)"
    axes[-1].set_xlabel("time since the start (s)" + diverged)
    axes[-1].set_xlim(view.time_s[0], view.time_s[-1])
    figure.align_ylabels(axes)


def _choose_limits(encoded: np.ndarray, predicted: np.ndarray) -> tuple[float, float]:
    """The range of both, but little more than that of the encoded coordinate where a forecast runs away."""
    low, high = float(encoded.min()), float(encoded.max())
    size = max(high - low, 1e-9)
    lowest, highest = low - ASIDE * size, high + ASIDE * size
    seen = predicted[np.isfinite(predicted)]
    low = max(min(low, float(seen.min(initial=low))), lowest)
    high = min(max(high, float(seen.max(initial=high))), highest)
    return low - 0.08 * size, high + 0.08 * size


def _draw_inputs(axis: Axes, view: LongRollout) -> None:
    units = {format_unit(unit) for unit in view.input_units} - {"unknown"}
    one = units.pop() if len(units) == 1 else ""
    for index, (name, unit) in enumerate(zip(view.input_names, view.input_units, strict=True)):
        text = name if one or unit in ("1", "unknown") else f"{name} ({format_unit(unit)})"
        axis.plot(view.time_s, view.inputs[:, index], label=text, **style.distinguish(index))
    axis.set_ylabel(f"inputs\n({one})" if one else "inputs")


def _draw_whole_images(axes: Any, images: LastImages, time_s: float) -> None:
    """Each panel adds one source of error to the one before."""
    height, width = images.at_encoded.shape[:2]
    rows, columns = images.recorded.shape[:2]
    axes[0].imshow(images.recorded, extent=(0, width, height, 0))
    axes[0].set_title(f"recorded\n{columns}×{rows}, at {time_s:.1f} s")
    axes[1].imshow(images.at_encoded)
    axes[1].set_title(f"render at encoded q\n{width}×{height}")
    axes[2].imshow(images.at_predicted)
    axes[2].set_title(f"render at predicted q\n{width}×{height}")
    axes[1].set_xlabel(f"MSE {format_number(images.floor_mse)}")
    ratio = images.predicted_mse / images.floor_mse if images.floor_mse > 0 else np.inf
    axes[2].set_xlabel(f"MSE {format_number(images.predicted_mse)}\n({ratio:.1f} × encoded)")
    corner, side = (images.inset.column, images.inset.row), images.inset.side
    for axis in axes:
        axis.add_patch(Rectangle(corner, side, side, fill=False, color=style.MARK, linewidth=0.9))
        _frame(axis, style.QUIET)


def _draw_windows(axes: Any, images: LastImages) -> None:
    """The two renders in the window, and how far the prediction lies off there."""
    inset = images.inset
    window = (slice(inset.row, inset.row + inset.side), slice(inset.column, inset.column + inset.side))
    for axis, image, state in zip(
        axes, (images.at_encoded, images.at_predicted), ("encoded", "predicted"), strict=True
    ):
        axis.imshow(image[window])
        axis.set_title(f"window\nat {state} q")
        _frame(axis, style.MARK)
        axis.spines[:].set_linewidth(1.2)
    length = float(np.hypot(*inset.shift_px))
    # A finer decoder may be shown, but the motion was read off frames of this size.
    height, width = (round(side / images.scale) for side in images.at_encoded.shape[:2])
    axes[1].set_xlabel(
        f"shift {length / images.scale:.2f} px\nin frames of {width}×{height},\n"
        f"{format_number(inset.ratio)} × the local\nreconstruction error"
    )
    if length >= MIN_SHIFT_PX:
        # of fixed length, through the middle
        half = 0.2 * inset.side * np.array(inset.shift_px)[::-1] / length
        middle = 0.5 * (inset.side - 1)
        style.draw_arrow(axes[1], middle - half, middle + half, style.PREDICTED, linewidth=1.3, rim=3.0)


def _frame(axis: Any, colour: str) -> None:
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(True)
    axis.spines[:].set_color(colour)
