"""A figure as SVG that can stand inside a page beside others."""

import html
import io
import re

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from lagsplat.report.common.style import paper_style

SETTLES = 3
PAD_IN = 0.09


def inline_svg(figure: Figure, *, key: str, title: str) -> str:
    """The ``<svg>`` element of ``figure``; ``key`` keeps its names apart from those of other figures.

    Letters are outlines, so that a page looks the same where the font is missing; ``title`` is read to those
    who cannot see it. The same figure gives the same text.
    """
    buffer = io.StringIO()
    with paper_style():
        layout = figure.get_layout_engine()
        if isinstance(layout, ConstrainedLayoutEngine):
            # Outlines of letters are a little wider than the pixels they are measured by.
            layout.set(w_pad=PAD_IN)
            # The layout refines itself at every drawing: long labels have their room after a few, and once
            # it is fixed the same figure stays the same.
            for _ in range(SETTLES):
                figure.draw_without_rendering()
            figure.set_layout_engine("none")
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with paper_style(), mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": key}):
        figure.savefig(buffer, format="svg", metadata=nothing)
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    # Equal images get equal names, to which nothing refers.
    text = re.sub(r'(<image\b[^>]*?)\sid="[^"]*"', r"\1", text)
    # Two figures of a page may not share a name: the second would borrow the clips of the first.
    text = re.sub(r'\bid="', f'id="{key}-', text)
    text = re.sub(r"url\(#", f"url(#{key}-", text)
    text = re.sub(r'href="#', f'href="#{key}-', text)
    head, _, rest = text.partition(">")
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)
    width_pt = 72.0 * figure.get_figwidth()
    # In print a figure has its own width; narrow screens shrink it.
    size = f'style="width:{width_pt:.0f}pt" role="img" aria-label="{html.escape(title)}"'
    return f"{head} {size}>{rest}"
