"""A sheet of a film before anything is fitted: its first image, where it moves, and the crop proposed."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lagsplat.report.common.style import PAGE_IN, PREDICTED, add_colorbar, new_figure, paper_style


@paper_style()
def draw_film_sheet(
    first: UInt8[np.ndarray, "H W 3"],
    motion: Float[np.ndarray, "h w"],
    crop: Sequence[int] | None,
    *,
    title: str,
) -> Figure:
    """Draw the first image, the motion of each pixel [level of 255], and the part that ``crop`` keeps.

    ``crop`` is (x, y, width, height) in pixels of the first image; None keeps all of it.
    """
    rows, columns = first.shape[:2]
    x, y, width, height = (0, 0, columns, rows) if crop is None else crop
    side = PAGE_IN / 3.2
    figure = new_figure(PAGE_IN, side * max(rows / columns, min(height / width, 1.5)) + 0.5, title=title)
    whole, energy, kept = figure.subplots(1, 3)
    whole.imshow(first)
    whole.set_title("first image", loc="left")
    shown = energy.imshow(motion, extent=(0, columns, rows, 0), cmap="magma")
    energy.set_title("motion" if motion.any() else "motion: nothing moves", loc="left")
    add_colorbar(figure, shown, energy, "rms change (level of 255)", location="bottom", shrink=0.9)
    kept.imshow(first[y : y + height, x : x + width], extent=(x, x + width, y + height, y))
    kept.set_title("no crop" if crop is None else f"crop, {width} x {height} px", loc="left")
    for axis in (whole, energy):
        if crop is not None:
            axis.add_patch(Rectangle((x, y), width, height, fill=False, edgecolor=PREDICTED, linewidth=1.2))
    return figure
