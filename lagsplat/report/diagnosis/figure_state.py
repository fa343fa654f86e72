"""Where on the picture the gap lies, and the stretch itself as a film.

At which positions and velocities the sim's force is off, before and after the effects.
"""

import base64
import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.report.common.formatting import format_percent
from lagsplat.report.common.style import ENCODED, PAGE_IN, PREDICTED, QUIET, new_figure, paper_style
from lagsplat.report.diagnosis.content import (
    ImageErrorMap,
    ImageForceMap,
    ReportContent,
    VideoComparison,
    get_location,
)
from lagsplat.report.diagnosis.figure_residual import get_coordinate_name

MAX_SIDE_PX = 480  # pixels of a film's larger side at most
MAX_FRAMES = 150  # of a film at most: a page stays a few megabytes
RULE_PX = 4  # pixels between the pictures of a film
IMAGE_COLOURS = "cividis"


def draw_image_maps(exhibits: ReportContent) -> Figure | None:
    """Excess error over a picture, and how well a force on each point explains the residual; None without."""
    gap, force = exhibits.picture, exhibits.force
    if gap is None and force is None:
        return None
    shape = (gap.picture if gap is not None else force.picture).shape  # type: ignore[union-attr]
    wide = 0.5 * (PAGE_IN - 0.9)
    with paper_style():
        figure = new_figure(PAGE_IN, min(0.4 + wide * shape[0] / shape[1], 4.5), title="")
        axes = figure.subplots(1, 2)
        if gap is None:
            _empty(axes[0], "no sim pictures to compare")
        else:
            _excess(figure, axes[0], gap)
        if force is None:
            _empty(axes[1], "force not placed")
        else:
            _force(figure, axes[1], force)
        return figure


def encode_video_uri(film: VideoComparison) -> str:
    """The three films side by side as one looping animation (WebP) in a data URI.

    Reduced to 150 frames and 480 pixels a picture at most; small pictures are enlarged pixel by pixel.

    Raises:
        ValueError: films of different shapes, or none that can be encoded.
    """
    if not film.real.shape == film.sim.shape == film.augmented.shape:
        raise ValueError(
            f"films of shapes {film.real.shape}, {film.sim.shape} and {film.augmented.shape}; "
            "give all three alike"
        )
    stride = -(-len(film.real) // MAX_FRAMES)
    rows = zip(film.real[::stride], film.sim[::stride], film.augmented[::stride], strict=True)
    animation = cv2.Animation()
    animation.frames = [_row(pictures) for pictures in rows]
    duration_ms = round(1000.0 * stride / film.frames_per_s)
    animation.durations = np.full(len(animation.frames), duration_ms, dtype=np.int32)  # type: ignore[assignment]
    animation.loop_count = 0
    made, encoded = cv2.imencodeanimation(".webp", animation, [cv2.IMWRITE_WEBP_QUALITY, 80])
    if not made:
        raise ValueError(f"{len(animation.frames)} frames of {film.real.shape[1:]} could not be made a film")
    return "data:image/webp;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")


def _row(pictures: tuple[UInt8[np.ndarray, "H W 3"], ...]) -> UInt8[np.ndarray, "h w 3"]:
    height, width = pictures[0].shape[:2]
    scale = MAX_SIDE_PX / max(height, width)
    scale = float(math.floor(scale)) if scale > 1.0 else scale
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    rule = np.full((size[1], RULE_PX, 3), 255, dtype=np.uint8)
    sized = [cv2.resize(one, size, interpolation=way) for one in pictures]
    joined = np.concatenate([sized[0], rule, sized[1], rule, sized[2]], axis=1)
    return np.ascontiguousarray(joined[..., ::-1])  # OpenCV's order of colours


def _excess(figure: Figure, axis: Any, gap: ImageErrorMap) -> None:
    _ground(axis, gap.picture)
    reach = max(float(np.max(gap.excess)), 1e-300)
    shown = np.clip(gap.excess / reach, 0.0, 1.0)
    picture = axis.imshow(shown, cmap=IMAGE_COLOURS, alpha=np.clip(1.5 * shown, 0.0, 0.9), vmin=0.0, vmax=1.0)
    for left, top, right, bottom, share in gap.parts:
        corner = (left - 0.5, top - 0.5)
        axis.add_patch(Rectangle(corner, right - left, bottom - top, fill=False, edgecolor=PREDICTED))
        above = top > 0.1 * gap.excess.shape[0]
        axis.annotate(
            format_percent(share), (left, top if above else bottom), (0, 2 if above else -2), color=PREDICTED,
            textcoords="offset points", va="bottom" if above else "top", fontsize=6,
            path_effects=[Stroke(linewidth=1.5, foreground="white"), Normal()],
        )  # fmt: skip
    axis.set_title("excess error of the sim's pictures", loc="left", pad=2)
    _bar(figure, axis, picture, "of its maximum")


def _force(figure: Figure, axis: Any, force: ImageForceMap) -> None:
    _ground(axis, force.picture)
    picture = axis.scatter(
        *force.points.T, c=np.clip(force.explained, 0.0, 1.0), cmap=IMAGE_COLOURS, s=14, vmin=0.0, vmax=1.0,
        edgecolors="white", linewidths=0.4,
    )  # fmt: skip
    title = "share that a force on each point explains"
    if force.localisable and len(force.near):
        near = list(force.near)
        longest = max(float(np.linalg.norm(force.forces[near], axis=1).max()), 1e-300)
        length = 0.25 * max(force.picture.shape[:2]) / longest
        arrows = length * force.forces[near]
        axis.quiver(
            *force.points[near].T, arrows[:, 0], arrows[:, 1], angles="xy", scale_units="xy", scale=1.0,
            color=PREDICTED, width=0.01, zorder=3,
        )  # fmt: skip
    else:
        title += "\nnot localisable: the motion cannot tell points apart"
    axis.set_title(title, loc="left", pad=2)
    _bar(figure, axis, picture, "share explained")


def _ground(axis: Any, picture: np.ndarray) -> None:
    grey = picture.mean(axis=2) / 255.0
    # Pale, so that colours on it keep their meaning.
    axis.imshow(0.5 + 0.5 * grey, cmap="gray", vmin=0.0, vmax=1.0)
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(True)
    axis.spines[:].set_color(QUIET)


def _bar(figure: Figure, axis: Any, picture: Any, label: str) -> None:
    bar = figure.colorbar(picture, ax=axis, pad=0.01, shrink=0.8, aspect=18)
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)


def _empty(axis: Any, text: str) -> None:
    axis.annotate(text, (0.5, 0.5), xycoords="axes fraction", ha="center", color=QUIET)
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


MAX_COORDINATES = 2  # coordinates
SIGNIFICANT_FROM = 2.0  # standard errors from which a bin is dotted
STATE_COLOURS = "PuOr_r"  # told apart with any colour vision, and light in the middle on paper
UNVISITED_COLOUR = "#EEEEEE"


def draw_state_maps(diagnosis: Diagnosis, exhibits: ReportContent) -> Figure | None:
    """Mean residual acceleration over position and velocity, and over position alone; None without maps."""
    before = list(get_location(diagnosis.where, "maps") or ())
    after = list(exhibits.maps_after)
    shares = get_location(diagnosis.where, "coordinates") or {}
    there = {one.coordinate for one in before}
    order = sorted(there, key=lambda i: (-shares.get(get_coordinate_name(diagnosis, i), 0.0), i))[
        :MAX_COORDINATES
    ]
    if not order:
        return None
    columns = 3 if after else 2
    with paper_style():
        figure = new_figure(PAGE_IN, 0.25 + 1.75 * len(order), title="")
        axes = figure.subplots(len(order), columns, squeeze=False)
        for row, at in zip(axes, order, strict=True):
            flat = [one for one in before if one.coordinate == at and len(one.velocity_edges) > 2]
            flat_after = [one for one in after if one.coordinate == at and len(one.velocity_edges) > 2]
            name = get_coordinate_name(diagnosis, at)
            reach = max((float(np.nanmax(np.abs(one.mean))) for one in flat[:1] if _any(one)), default=0.0)
            panels = [("sim", flat)] + ([("sim with effects", flat_after)] if after else [])
            picture = None
            for axis, (title, maps) in zip(row, panels, strict=False):
                picture = _map(axis, maps, reach, name, title) or picture
            if maps_box := (get_location(diagnosis.where, "state_region") or {}).get(name):
                _boxes(row[0], maps_box)
            if picture is not None:
                bar = figure.colorbar(picture, ax=list(row[: columns - 1]), pad=0.01, aspect=12)
                bar.set_label(f"real − sim ({name}/s²)")
                bar.outline.set_linewidth(0.5)
            _profile(row[-1], [one for one in before if one.coordinate == at],
                     [one for one in after if one.coordinate == at], name)  # fmt: skip
        return figure


def _any(one: Any) -> bool:
    return bool(np.isfinite(one.mean).any())


def _map(axis: Any, maps: Sequence[Any], reach: float, name: str, title: str) -> Any:
    axis.set_title(title, loc="left", pad=2)
    axis.set(xlabel=name, ylabel=f"{name} rate (1/s)")
    axis.set_facecolor(UNVISITED_COLOUR)
    if not maps or not _any(maps[0]):
        axis.annotate("not computed", (0.5, 0.5), xycoords="axes fraction", ha="center")
        return None
    one = maps[0]
    reach = reach or 1.0
    picture = axis.pcolormesh(
        one.position_edges, one.velocity_edges, np.ma.masked_invalid(one.mean).T, cmap=STATE_COLOURS,
        vmin=-reach, vmax=reach, antialiased=False,
    )  # fmt: skip
    rows, columns = np.nonzero((np.abs(one.score) > SIGNIFICANT_FROM) & np.isfinite(one.mean))
    middle = [0.5 * (edges[1:] + edges[:-1]) for edges in (one.position_edges, one.velocity_edges)]
    axis.plot(middle[0][rows], middle[1][columns], ".", color="black", markersize=1.5)
    return picture


def _boxes(axis: Any, regions: Sequence[Any]) -> None:
    """The regions in which the residual keeps its sign."""
    for region in regions:
        position, velocity = region.get("position"), region.get("velocity")
        if not position or not velocity:
            continue
        corner = (position[0], velocity[0])
        sides = (position[1] - position[0], velocity[1] - velocity[0])
        axis.add_patch(Rectangle(corner, *sides, fill=False, edgecolor="black", linewidth=0.9))


def _profile(axis: Any, before: Sequence[Any], after: Sequence[Any], name: str) -> None:
    """Mean along position or along velocity, whichever the sim's residual varies with more."""
    first = _along(before)
    along = max(first, key=lambda key: float(np.ptp(first[key][1])) if len(first[key][1]) else 0.0)
    for marginals, label, color, line in (
        (first, "sim", PREDICTED, (0, (4, 1.5))),
        (_along(after) if after else {}, "sim with effects", ENCODED, "-"),
    ):
        if along in marginals:
            _steps(axis, *marginals[along], label, color, line)
    axis.axhline(0.0, color="black", linewidth=0.5)
    axis.set(xlabel=name if along == "position" else f"{name} rate (1/s)", ylabel=f"real − sim ({name}/s²)")
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)


def _along(maps: Sequence[Any]) -> dict[str, tuple[np.ndarray, np.ma.MaskedArray]]:
    """Edges and mean residual along position, and along velocity where a map has both."""
    one = max(maps, key=lambda one: len(one.velocity_edges))
    mean = np.ma.masked_invalid(one.mean)
    found = {"position": (one.position_edges, mean.mean(axis=1))}
    if len(one.velocity_edges) > 2:
        found["velocity"] = (one.velocity_edges, mean.mean(axis=0))
    return found


def _steps(axis: Any, edges: np.ndarray, mean: np.ma.MaskedArray, label: str, color: str, line: Any) -> None:
    axis.stairs(
        np.ma.filled(mean.astype(float), np.nan),
        edges,
        baseline=None,
        label=label,
        color=color,
        linestyle=line,
    )
