"""The rollout figure: latent coordinates over time above, three images and their insets below."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke

from lagsplat.evaluate.long_rollout import LongRollout
from lagsplat.report.common.style import (
    ENCODED,
    INPUTS,
    MARK,
    PAGE_IN,
    PREDICTED,
    QUIET,
    new_figure,
    paper_style,
)
from lagsplat.report.figures.training_curves import order_by_visibility

MIN_SHIFT_PX = 0.25
HELD_OUT_COLOUR = "#E6E6E6"


def draw_rollout(view: LongRollout, *, title: str) -> Figure:
    """Draw encoded and predicted coordinates, most visible first, and the last state as images.

    Below: the recorded image, the render at the encoded state (the image model's own floor) and at the
    predicted one, with the window where the two renders differ most in excess of the image model's error,
    magnified. The arrow gives the direction of the measured shift there, not its length. Held-out frames are
    shaded where the stretch begins with training frames.

    Source: paper, Reading the rollout figures.
    """
    panels = view.encoded.shape[1] + int(view.inputs.shape[1] > 0)
    with paper_style():
        height, width = view.at_encoded.shape[:2]
        # five images side by side, upright or not, between two lines of title and three of numbers
        top_in, bottom_in = 0.62 * panels + 0.3, 0.85 + PAGE_IN / 5.2 * max(height / width, 1.0)
        figure = new_figure(PAGE_IN, top_in + bottom_in + 0.45, title=f"{title}\n{_write_scores(view)}")
        above, below = figure.subfigures(2, 1, height_ratios=[top_in, bottom_in], squeeze=False)[:, 0]
        _draw_series(above, view)
        _draw_images(below, view)
    return figure


def _write_scores(view: LongRollout) -> str:
    """The caption line: scores over the drawn stretch."""
    length = view.time_s[-1]
    text = f"latent NRMSE {view.nrmse:.3f} over {length:.1f} s"
    if view.period_s is not None:
        text += f", {length / view.period_s:.1f} natural periods of {view.period_s:.2f} s"
    if view.held_s is not None:
        text += f"; {view.held_nrmse:.3f} over the held-out {length - view.held_s:.1f} s (shaded)"
    return text


def _draw_series(figure: Any, view: LongRollout) -> None:
    order, share = order_by_visibility(view.metric)
    n_input_rows = int(view.inputs.shape[1] > 0)
    heights = [1.0] * len(order) + [0.7] * n_input_rows
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axis, index, part in zip(axes, order, share, strict=False):
        axis.plot(view.time_s, view.encoded[:, index], color=ENCODED, label="encoded frames")
        axis.plot(
            view.time_s, view.predicted[:, index], color=PREDICTED, label="predicted", linestyle=(0, (4, 1))
        )
        axis.set_ylabel(f"$q_{{{index + 1}}}$")
        axis.set_title(f"{100 * part:.1f} % of tr G", loc="right", pad=2)
        low, high = view.encoded[:, index].min(), view.encoded[:, index].max()
        margin = 0.35 * max(high - low, 1e-9)
        axis.set_ylim(low - margin, high + margin)
        if view.held_s is not None:
            axis.axvspan(view.held_s, view.time_s[-1], color=HELD_OUT_COLOUR, linewidth=0, zorder=0)
        if view.lost_s is not None:
            axis.axvline(view.lost_s, color=MARK, linestyle=":")
    axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=2, borderaxespad=0.0)
    if n_input_rows:
        for column in range(view.inputs.shape[1]):
            axes[-1].plot(
                view.time_s, view.inputs[:, column], color=INPUTS[column % len(INPUTS)], linewidth=0.6
            )
        axes[-1].set_ylabel(f"inputs\n({', '.join(view.input_units)})")
    axes[-1].set_xlabel("time since the start (s)" + _mention_divergence(view))
    axes[-1].set_xlim(view.time_s[0], view.time_s[-1])
    figure.align_ylabels(axes)


def _mention_divergence(view: LongRollout) -> str:
    return "" if view.lost_s is None else f"; the rollout diverged at {view.lost_s:.1f} s (dotted)"


def _draw_images(figure: Any, view: LongRollout) -> None:
    axes = figure.subplots(1, 5)
    _draw_whole_images(axes[:3], view)
    _draw_windows(axes[3:], view)
    for axis in axes:
        axis.set(xticks=[], yticks=[])
        axis.spines[:].set_visible(True)
        axis.spines[:].set_color(QUIET)
    for axis in axes[3:]:
        axis.spines[:].set_color(MARK)
        axis.spines[:].set_linewidth(1.2)


def _draw_whole_images(axes: Any, view: LongRollout) -> None:
    """Each panel adds one source of error to the one before."""
    height, width = view.at_encoded.shape[:2]
    rows, columns = view.recorded.shape[:2]
    axes[0].imshow(view.recorded, extent=(0, width, height, 0))
    axes[0].set_title(f"recorded\n{columns}×{rows}, at {view.time_s[-1]:.1f} s")
    axes[1].imshow(view.at_encoded)
    axes[1].set_title(f"render at encoded q\n{width}×{height}")
    axes[2].imshow(view.at_predicted)
    axes[2].set_title(f"render at predicted q\n{width}×{height}")
    axes[1].set_xlabel(f"MSE {view.floor_mse:.2e}")
    ratio = view.predicted_mse / view.floor_mse if view.floor_mse > 0 else np.inf
    axes[2].set_xlabel(f"MSE {view.predicted_mse:.2e}\n({ratio:.1f} × encoded)")
    inset = view.inset
    for axis in axes:
        corner = (inset.column, inset.row)
        axis.add_patch(Rectangle(corner, inset.side, inset.side, fill=False, color=MARK, linewidth=0.9))


def _draw_windows(axes: Any, view: LongRollout) -> None:
    """The two renders in the window, and how far the prediction lies off there."""
    inset = view.inset
    window = (slice(inset.row, inset.row + inset.side), slice(inset.column, inset.column + inset.side))
    for axis, image, state in zip(
        axes, (view.at_encoded, view.at_predicted), ("encoded", "predicted"), strict=True
    ):
        axis.imshow(image[window])
        axis.set_title(f"window\nat {state} q")
    length = float(np.hypot(*inset.shift_px))
    # A finer decoder may be shown, but the motion was read off frames of this size.
    height, width = (round(side / view.scale) for side in view.at_encoded.shape[:2])
    axes[1].set_xlabel(
        f"shift {length / view.scale:.2f} px (of {width}×{height})\n"
        f"{inset.ratio:.1f} × the local\nreconstruction error"
    )
    if length >= MIN_SHIFT_PX:
        _draw_arrow(axes[1], inset.side, np.array(inset.shift_px) / length)


def _draw_arrow(axis: Any, side: int, direction: np.ndarray) -> None:
    """An arrow of fixed length through the middle; a white rim keeps it visible on any ground."""
    down, right = 0.2 * side * direction
    middle = 0.5 * (side - 1)
    arrow = axis.annotate(
        "",
        xy=(middle + right, middle + down),
        xytext=(middle - right, middle - down),
        arrowprops={"arrowstyle": "-|>", "color": PREDICTED, "linewidth": 1.3, "mutation_scale": 8},
    )
    arrow.arrow_patch.set_path_effects([Stroke(linewidth=3.0, foreground="white"), Normal()])
