"""Figures of matter: the bodies of a film over its picture, and the paths of material points."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Float64
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lagsplat.evaluate.material_paths import MaterialPaths
from lagsplat.integer_lists import choose_evenly
from lagsplat.matter.field import MatterField
from lagsplat.report.common.style import PAGE_IN, new_figure, paper_style
from lagsplat.views.camera import project_by_lens

TRAILS = 30  # points whose paths are drawn
BODY_COLOURS = ("#0072B2", "#D55E00", "#009E73")
FOUND_COLOUR, TRUE_COLOUR = "#FFD400", "#FFFFFF"
REACH = 1.5  # deviations of the state on each side over which a path is drawn
STEPS = 41  # of a path


def draw_matter(
    matter: MatterField,
    picture: Float[np.ndarray, "H W 3"],
    paths: MaterialPaths | None,
    *,
    title: str,
    lens: Sequence[float] | None = None,
) -> Figure:
    """Draw the bodies of a film, how their points move along each latent and, where known, true paths.

    Args:
        matter: the field.
        picture: of the film at the mean state, colours in [0, 1].
        paths: of material points in held-out frames; None where the truth is not known.
        title: of the figure.
        lens: focal lengths and principal point (x, y, x, y) [px] of the camera, for matter in space.
    """
    columns = 2 + (paths is not None)
    height, width = picture.shape[:2]
    with paper_style():
        figure = new_figure(PAGE_IN, PAGE_IN / columns * height / width + 0.7, title=title)
        axes = figure.subplots(1, columns, squeeze=False)[0]
        for each in axes:
            each.imshow(picture.clip(0.0, 1.0), extent=(0, width, height, 0), interpolation="nearest")
            each.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[])
        _draw_bodies(axes[0], matter, lens)
        _draw_ways(axes[1], matter, lens)
        if paths is not None:
            _draw_paths(axes[2], paths, lens)
    return figure


def _see(places: Float64[np.ndarray, "*N n"], lens: Sequence[float] | None) -> Float64[np.ndarray, "*N 2"]:
    """Places in the picture [px]."""
    return places if lens is None else project_by_lens(places, lens)


def _draw_bodies(axes: Axes, matter: MatterField, lens: Sequence[float] | None) -> None:
    named = []
    for number, motion in enumerate(matter.bodies):
        x, y = _see(matter.points[matter.body == number].numpy(), lens).T
        colour = BODY_COLOURS[number % len(BODY_COLOURS)]
        axes.scatter(x, y, s=4, marker="s", linewidths=0, color=colour, alpha=0.6)
        named.append(f"{f'bends, degree {motion.bending}' if motion.bending else 'rigid'}, {len(x)} px")
    axes.set_title("bodies: " + "; ".join(named))


def _draw_ways(axes: Axes, matter: MatterField, lens: Sequence[float] | None) -> None:
    """Ways of some points along each latent, two deviations to both sides."""
    chosen = torch.tensor(choose_evenly(len(matter.points), TRAILS))
    along = torch.linspace(-REACH, REACH, STEPS, dtype=torch.float64)
    for i in range(matter.d):
        states = along[:, None] * torch.eye(matter.d, dtype=torch.float64)[i]
        places = _see(matter.carry(states)[:, chosen].numpy(), lens)
        axes.plot(*np.moveaxis(places, 2, 0), color=f"C{i}", linewidth=0.8)
    axes.set_title(f"ways of points over ±{REACH:g} deviations of each coordinate")


def _draw_paths(axes: Axes, paths: MaterialPaths, lens: Sequence[float] | None) -> None:
    known = np.flatnonzero(paths.known)
    chosen = known[choose_evenly(len(known), TRAILS)] if len(known) else known
    for name, places, colour, width in (
        ("true", paths.true, TRUE_COLOUR, 1.6),
        ("found", paths.found, FOUND_COLOUR, 0.6),
    ):
        seen = _see(places[:, chosen], lens)
        lines = axes.plot(*np.moveaxis(seen, 2, 0), color=colour, linewidth=width)
        for line in lines[:1]:
            line.set_label(name)
    axes.set_title("held-out paths")
    if (error := paths.measure()["path"]) is not None:
        axes.legend(loc="lower right", fontsize=6, facecolor="black", labelcolor="white", framealpha=0.5)
        axes.set_title(f"held-out paths, error {error:.1%}")
