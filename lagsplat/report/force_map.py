"""Errors of the answers to known forces, at the points on which the forces acted."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from lagsplat.report.style import PAGE_IN, new_figure, paper_style

SHOWN = (
    ("direction_deg", "direction of the pushed point (degrees)", 1.0, 60.0),
    ("shape", "shape of the answer (%)", 100.0, 100.0),
    ("amplitude", "amplitude after one poke (%)", 100.0, 100.0),
)


def draw_force_map(picture: Float[np.ndarray, "H W 3"], truth: Mapping[str, Any], *, title: str) -> Figure:
    """Three pictures of the object at rest, with the median error of forces on each point in colour.

    ``truth`` is what `lagsplat.evaluate.force_truth.compare` returns, or the reason why there is nothing.
    """
    height, width = picture.shape[:2]
    with paper_style():
        figure = new_figure(PAGE_IN, PAGE_IN / 3.0 * height / width + 0.75, title=title)
        if "refused" in truth:
            figure.text(0.01, 0.5, f"nothing was measured: {truth['refused']}", wrap=True)
            return figure
        rows = truth["map"]
        for axis, (name, what, scale, most) in zip(figure.subplots(1, 3), SHOWN, strict=True):
            axis.imshow(picture.clip(0.0, 1.0), extent=(0, width, height, 0), alpha=0.45)
            told = [(*row["place"], scale * row[name]) for row in rows if row[name] is not None]
            x, y, values = np.array(told).reshape(-1, 3).T
            dots = axis.scatter(
                x, y, c=values, s=26, vmin=0.0, vmax=most, cmap="viridis_r", edgecolors="k", linewidths=0.3
            )
            figure.colorbar(dots, ax=axis, orientation="horizontal", extend="max", shrink=0.9, aspect=30)
            axis.set(xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0), title=what)
    return figure
