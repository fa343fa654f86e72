"""Nine equilibria under forces given in the image, each with its arrow and the outline of the rest."""

from string import ascii_lowercase

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke

from lagsplat.report.force_panels import Panel, Panels
from lagsplat.report.style import PAGE_IN, new_figure, paper_style

FORCE = "#AA1E1E"
LONGEST = 0.3
"""Of the picture's smaller side: the longest arrow."""


def draw_forces(shown: Panels, *, title: str) -> Figure:
    """Three by three pictures of the loaded states. Red arrows, all on one scale, start where the pushed
    matter has come to; the dashed line is the outline of what moves, at rest.

    Source: paper, figures of interactive forces.
    """
    height, width = shown.size
    largest = max(float(np.linalg.norm(panel.arrows[:, 1], axis=1).max()) for panel in shown.panels)
    scale = LONGEST * min(height, width) / largest
    with paper_style():
        side = PAGE_IN / 3.0
        rows = -(-len(shown.panels) // 3)
        figure = new_figure(PAGE_IN, rows * (side * height / width + 0.1) + 0.35, title=title)
        axes = figure.subplots(rows, 3, squeeze=False).ravel()
        for axis, letter, panel in zip(axes, ascii_lowercase, shown.panels, strict=False):
            axis.imshow(panel.picture.clip(0.0, 1.0), extent=(0, width, height, 0))
            _outline(axis, shown)
            for foot, force in panel.arrows:
                draw_arrow(axis, foot, scale * force)
            axis.set_title(f"({letter}) {panel.name}: {_answer(panel)}", loc="left")
        for axis in axes:
            axis.set(xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0))
        for axis in axes[len(shown.panels) :]:
            axis.set_axis_off()
    return figure


def _answer(panel: Panel) -> str:
    way = rf", {panel.moved_px:.1f} px"
    if len(panel.shift) == 1:
        return rf"$\Delta q = {panel.shift[0]:+.{2 if abs(panel.shift[0]) > 0.05 else 4}f}$" + way
    return rf"$|\Delta q| = {np.linalg.norm(panel.shift):.2f}$" + way


def _outline(axis: Axes, shown: Panels) -> None:
    fine = shown.object.astype(float)
    rows, columns = (
        size * (np.arange(count) + 0.5) / count for size, count in zip(shown.size, fine.shape, strict=True)
    )
    axis.contour(columns, rows, fine, levels=[0.5], colors="white", linewidths=0.8, linestyles="dashed")


def draw_arrow(axis: Axes, foot: np.ndarray, way: np.ndarray) -> None:
    """A red arrow with a white rim, its foot marked [px]."""
    arrow = axis.annotate(
        "",
        xy=tuple(foot + way),
        xytext=tuple(foot),
        arrowprops={
            "arrowstyle": "-|>",
            "color": FORCE,
            "linewidth": 1.4,
            "mutation_scale": 8,
            "shrinkA": 0.0,
            "shrinkB": 0.0,
        },
        annotation_clip=False,
    )
    rim = [Stroke(linewidth=2.6, foreground="white"), Normal()]
    if arrow.arrow_patch is not None:
        arrow.arrow_patch.set_path_effects(rim)
    axis.plot(*foot, "o", color=FORCE, markersize=2.5, markeredgecolor="white", markeredgewidth=0.5)
