"""All figures of a folder of results on one sheet, small, each with its name."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from lagsplat.report.common.style import PAGE_IN, QUIET, new_figure, paper_style

COLUMNS = 3
EDGE_IN, GAP_IN, NAME_IN, TITLE_IN = 0.08, 0.12, 0.2, 0.3
DPI = 300  # to which the pictures are reduced


def draw_contact_sheet(pictures: Sequence[tuple[str, Image.Image]], *, title: str) -> Figure:
    """Draw named pictures in three columns; the next one is added to the column that is shortest.

    Raises:
        ValueError: there is none.
    """
    if not pictures:
        raise ValueError("no figure was planned, so there is nothing to put on a sheet")
    cell_in = (PAGE_IN - 2.0 * EDGE_IN - GAP_IN * (COLUMNS - 1)) / COLUMNS
    filled_in, places = [0.0] * COLUMNS, []
    for _, picture in pictures:
        column = int(np.argmin(filled_in))
        height_in = cell_in * picture.height / picture.width
        places.append((EDGE_IN + column * (cell_in + GAP_IN), filled_in[column] + NAME_IN, height_in))
        filled_in[column] += NAME_IN + height_in + GAP_IN
    height_in = TITLE_IN + max(filled_in)
    with paper_style():
        figure = new_figure(PAGE_IN, height_in, title=title)
        figure.set_layout_engine("none")
        for (name, picture), (left_in, top_in, own_in) in zip(pictures, places, strict=True):
            bottom = 1.0 - (TITLE_IN + top_in + own_in) / height_in
            axis = figure.add_axes((left_in / PAGE_IN, bottom, cell_in / PAGE_IN, own_in / height_in))
            size = (round(DPI * cell_in), max(round(DPI * own_in), 1))
            axis.imshow(np.asarray(picture.convert("RGB").resize(size)), aspect="auto")
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set(visible=True, color=QUIET, linewidth=0.3)
            axis.set_title(name, loc="left", pad=2, fontsize=5.0)
    return figure
