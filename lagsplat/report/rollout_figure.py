"""The rollout figure: latent coordinates over time above, three images and their insets below."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lagsplat.report.latents import visibility_order
from lagsplat.report.rollout import LongRollout
from lagsplat.report.style import (
    ENCODED,
    INPUTS,
    MARK,
    PAGE_IN,
    PREDICTED,
    QUIET,
    new_figure,
    paper_style,
)

LEAST_SHIFT_PX = 0.25


def draw_rollout(view: LongRollout, *, title: str) -> Figure:
    """Encoded against predicted coordinates, most visible first, and the last state as images.

    Below: the recorded image, the render at the encoded state (the image model's own floor) and at the
    predicted one, with the window where the two renders differ most, magnified. The
    arrow gives the direction of the measured shift there, not its length.

    Source: paper, figures of rollouts.
    """
    panels = view.encoded.shape[1] + int(view.inputs.shape[1] > 0)
    with paper_style():
        top_in, bottom_in = 0.62 * panels + 0.3, 2.1
        figure = new_figure(PAGE_IN, top_in + bottom_in + 0.3, title=title)
        above, below = figure.subfigures(2, 1, height_ratios=[top_in, bottom_in], squeeze=False)[:, 0]
        _series(above, view)
        _images(below, view)
    return figure


def _series(figure: Any, view: LongRollout) -> None:
    order, share = visibility_order(view.metric)
    slim = int(view.inputs.shape[1] > 0)
    heights = [1.0] * len(order) + [0.7] * slim
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axis, index, part in zip(axes, order, share, strict=False):
        axis.plot(view.time_s, view.encoded[:, index], color=ENCODED, label="encoded frames")
        axis.plot(
            view.time_s, view.predicted[:, index], color=PREDICTED, label="predicted", linestyle=(0, (4, 1))
        )
        axis.set_ylabel(f"$q_{{{index + 1}}}$")
        axis.set_title(f"{100 * part:.1f} % of tr G", loc="right", pad=2)
        low, high = view.encoded[:, index].min(), view.encoded[:, index].max()
        room = 0.35 * max(high - low, 1e-9)
        axis.set_ylim(low - room, high + room)
        if view.lost_s is not None:
            axis.axvline(view.lost_s, color=MARK, linestyle=":")
    axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=2, borderaxespad=0.0)
    if slim:
        for column in range(view.inputs.shape[1]):
            axes[-1].plot(
                view.time_s, view.inputs[:, column], color=INPUTS[column % len(INPUTS)], linewidth=0.6
            )
        axes[-1].set_ylabel(f"inputs\n({', '.join(view.input_units)})")
    axes[-1].set_xlabel("time since the start (s)" + _lost(view))
    axes[-1].set_xlim(view.time_s[0], view.time_s[-1])
    figure.align_ylabels(axes)


def _lost(view: LongRollout) -> str:
    return "" if view.lost_s is None else f"; the rollout diverged at {view.lost_s:.1f} s (dotted)"


def _images(figure: Any, view: LongRollout) -> None:
    height, width = view.at_encoded.shape[:2]
    axes = figure.subplots(1, 5)
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
    window = (slice(inset.row, inset.row + inset.side), slice(inset.column, inset.column + inset.side))
    axes[3].imshow(view.at_encoded[window])
    axes[4].imshow(view.at_predicted[window])
    axes[3].set_title("window\nat encoded q")
    axes[4].set_title("window\nat predicted q")
    length = float(np.hypot(*inset.shift_px))
    axes[4].set_xlabel(f"shift {length:.1f} px\n({length / view.scale:.2f} px as recorded)")
    for axis in axes[1:3]:
        axis.add_patch(
            Rectangle(
                (inset.column, inset.row), inset.side, inset.side, fill=False, color=MARK, linewidth=0.9
            )
        )
    if length >= LEAST_SHIFT_PX:
        _arrow(axes[4], inset.side, np.array(inset.shift_px) / length)
    for axis in axes:
        axis.set(xticks=[], yticks=[])
        axis.spines[:].set_visible(True)
        axis.spines[:].set_color(QUIET)
    for axis in axes[3:]:
        axis.spines[:].set_color(MARK)


def _arrow(axis: Any, side: int, direction: np.ndarray) -> None:
    """An arrow of fixed length through the middle; white under it keeps it visible on any ground."""
    down, right = 0.2 * side * direction
    middle = 0.5 * (side - 1)
    for colour, line in (("white", 3.0), (PREDICTED, 1.3)):
        axis.annotate(
            "",
            xy=(middle + right, middle + down),
            xytext=(middle - right, middle - down),
            arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": line, "mutation_scale": 7},
        )
