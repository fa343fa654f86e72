"""A figure as SVG that can stand inside a page beside others."""

import io
import re

import matplotlib as mpl
from matplotlib.figure import Figure

from lagsplat.report.style import paper_style


def inline_svg(figure: Figure, *, key: str, title: str) -> str:
    """The ``<svg>`` element of ``figure``; ``key`` keeps its names apart from those of other figures.

    Letters are outlines, so that a page looks the same where the font is missing; ``title`` is read to those
    who cannot see it. The same figure gives the same text.
    """
    buffer = io.StringIO()
    with paper_style(), mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": key}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # Two figures of a page may not share a name: the second would borrow the clips of the first.
    text = re.sub(r'\bid="', f'id="{key}-', text)
    text = re.sub(r"url\(#", f"url(#{key}-", text)
    text = re.sub(r'href="#', f'href="#{key}-', text)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    width = re.search(r'viewBox="0 0 ([\d.]+)', text)
    points = float(width.group(1)) if width else 0.0
    # The printed width is the figure's own; narrow screens shrink it.
    size = f'style="width:{points:.0f}pt;max-width:100%;height:auto"'
    spoken = _escaped(title)
    text = re.sub(
        r'<svg\b([^>]*?)\swidth="[^"]*"([^>]*?)>', rf"<svg\1\2>", re.sub(r'(<svg\b[^>]*?)\sheight="[^"]*"', r"\1", text, count=1), count=1
    )
    return text.replace("<svg", f'<svg role="img" aria-label="{spoken}" {size}', 1)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
