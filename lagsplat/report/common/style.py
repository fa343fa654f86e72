"""One look for every figure, set in a context and never globally; figures as files and for pages."""

import base64
import io
import math
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patheffects import Normal, Stroke

from lagsplat.io.files.atomic import replace_atomically
from lagsplat.report.common.formatting import format_power_of_ten

PAGE_IN = 7.0
STYLE_SHEET = Path(__file__).parent / "templates" / "paper.mplstyle"
# Okabe and Ito's palette, for readers with any common colour vision.
ENCODED, PREDICTED, MARK, QUIET = "#0072B2", "#D55E00", "#009E73", "#7F7F7F"
MARK_WORDS = "#00795A"  # the same green for words: dark enough on white
INPUTS = ("#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#F0E442", "#000000")
INPUT_DASHES = ("-", (0, (5, 1.2)), (0, (3, 1, 1, 1)), (0, (1, 1)))
INK = "#222222"
GRID = "#DDDDDD"
ALONG_X, ALONG_Y = ("data", "axes fraction"), ("axes fraction", "data")
"""Coordinates of a text: data along one direction, and the share of the axis along the other."""
SVG_LAYOUT_PASSES = 3  # at most
SVG_LAYOUT_TOLERANCE = 1e-3  # by which axes may move in the last pass [share of the figure]: a pixel
SVG_PAD_IN = 0.09
MAX_PLAIN_POWER = 3  # largest power of ten that is written out


@contextmanager
def paper_style() -> Iterator[None]:
    """Type, lines and vector text of a two-column paper, inside the block or the decorated function only."""
    with style.context(STYLE_SHEET):
        yield


def new_figure(width_in: float, height_in: float, *, title: str = "") -> Figure:
    """Create an empty figure with its caption line; call it within `paper_style`."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def distinguish(index: int) -> dict[str, Any]:
    """Colour and dashes of the line of input ``index``, so that it is known without its colour, too."""
    dashes = INPUT_DASHES[index % len(INPUT_DASHES)]
    return {"color": INPUTS[index % len(INPUTS)], "linestyle": dashes}


def label_decades(axis: Axis) -> None:
    """Label decades as 0.1, 1, 10, far ones as powers, and nothing between."""
    axis.set_major_formatter(lambda x, _: _format_decade(x))
    axis.set_minor_formatter(lambda x, _: "")


def _format_decade(x: float) -> str:
    if not x > 0.0:
        return ""
    power = round(math.log10(x))
    return f"{x:g}" if abs(power) <= MAX_PLAIN_POWER else format_power_of_ten(power)


def add_colorbar(figure: Figure, image: Any, axes: Any, label: str, **settings: Any) -> Colorbar:
    """Add a labelled colour bar of ``image`` beside ``axes``; ``settings`` as of `Figure.colorbar`."""
    bar = figure.colorbar(image, ax=axes, pad=0.01, **settings)
    bar.set_label(label)
    return bar


def annotate(
    axis: Axes, text: str, point: tuple[Any, Any], offset: tuple[int, int] = (0, 0), **style: Any
) -> None:
    """Write ``text`` at a point of an axis, ``offset`` points to the right and up; ``style`` as there."""
    axis.annotate(text, point, offset, textcoords="offset points", **style)


def draw_arrow(
    axis: Axes, start: Any, stop: Any, colour: str, *, linewidth: float, rim: float, shrink: float = 2.0
) -> None:
    """Draw an arrow between two points; a white rim of width ``rim`` keeps it visible on any ground."""
    look = {"arrowstyle": "-|>", "color": colour, "linewidth": linewidth, "mutation_scale": 8}
    look |= {"shrinkA": shrink, "shrinkB": shrink}
    arrow = axis.annotate("", tuple(stop), tuple(start), arrowprops=look, annotation_clip=False)
    if arrow.arrow_patch is not None:
        arrow.arrow_patch.set_path_effects([Stroke(linewidth=rim, foreground="white"), Normal()])


def add_badge(axis: Axes, text: str) -> None:
    """Write ``text`` on a dark ground in the lower left corner of an image, readable on any picture."""
    ground = {"facecolor": INK, "edgecolor": "white", "linewidth": 0.5, "pad": 1.8}
    axis.text(0.025, 0.03, text, color="white", transform=axis.transAxes, bbox=ground, fontsize=6.5)


def place_legend_above(axis: Axes, columns: int, height: float = 1.0) -> None:
    """Place the legend above the right end of an axis, at ``height`` in shares of the axis."""
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, height), ncols=columns, borderaxespad=0.0)


def save_figures(paths: Iterable[str], figure: Figure) -> None:
    """Write one drawing in every format that the suffixes of ``paths`` ask for."""
    for path in paths:
        save_figure(path, figure)


def save_figure(path: str | os.PathLike[str], figure: Figure) -> None:
    """Write a figure, whole or not at all, in the format of its suffix and without a date inside."""
    suffix = os.fspath(path).rpartition(".")[2]
    dates: dict[str, None] = {"CreationDate": None} if suffix == "pdf" else {}
    with paper_style(), replace_atomically(path) as temporary:
        if figure.get_layout_engine() is not None:
            figure.draw_without_rendering()
            # The layout refines itself at every drawing; one pass, and every format shows the same drawing.
            figure.set_layout_engine("none")
        figure.savefig(temporary, metadata=dates)


def encode_svg_uri(figure: Figure) -> str:
    """Encode a figure as SVG in a data URI for an ``<img>`` element; the same figure gives the same text.

    Letters are outlines, so that a page looks the same where the font is missing. A dollar in the name of a
    column or a file is no formula.
    """
    buffer = io.BytesIO()
    settings = {"svg.fonttype": "path", "svg.hashsalt": "lagsplat", "text.parse_math": False}
    with paper_style(), mpl.rc_context(settings):  # type: ignore[arg-type]
        layout = figure.get_layout_engine()
        if isinstance(layout, ConstrainedLayoutEngine):
            # Outlines of letters are a little wider than the pixels they are measured by.
            layout.set(w_pad=SVG_PAD_IN)
            _settle_layout(figure, layout)
            figure.set_layout_engine("none")
        figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _settle_layout(figure: Figure, layout: ConstrainedLayoutEngine) -> None:
    # A pass of the layout leaves long labels some space too few; another one mends that.
    placed = None
    for _ in range(SVG_LAYOUT_PASSES):
        layout.execute(figure)
        before, placed = placed, [axes.get_position().bounds for axes in figure.axes]
        if before is not None and np.allclose(before, placed, rtol=0.0, atol=SVG_LAYOUT_TOLERANCE):
            return
