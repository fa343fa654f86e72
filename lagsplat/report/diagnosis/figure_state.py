"""Where the gap lies in the image and in the state, and the held-out stretch as a video."""

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
from lagsplat.report.common.style import (
    ENCODED,
    PAGE_IN,
    PREDICTED,
    QUIET,
    add_colorbar,
    annotate,
    new_figure,
    paper_style,
    place_legend_above,
)
from lagsplat.report.diagnosis.content import (
    ImageErrorMap,
    ImageForceMap,
    ReportContent,
    VideoComparison,
    get_location,
)
from lagsplat.report.diagnosis.figure_residual import get_coordinate_name

MAX_SIDE_PX = 480  # of the larger side of a frame
MAX_FRAMES = 150  # of a video, so that a page stays a few megabytes
RULE_PX = 4  # between the frames of a video
IMAGE_COLOURS = "cividis"
MAX_COORDINATES = 2  # coordinates
SIGNIFICANT_FROM = 2.0  # standard errors from which a bin bears a dot
STATE_COLOURS = "PuOr_r"  # for readers with any colour vision, and light in the middle on paper
UNVISITED_COLOUR = "#EEEEEE"


def draw_image_maps(content: ReportContent) -> Figure | None:
    """Draw the excess error over a frame, and how well a force on each point explains the residual.

    None where neither was computed.
    """
    gap, force = content.image_error, content.image_force
    if gap is None and force is None:
        return None
    shape = (gap.frame if gap is not None else force.frame).shape  # type: ignore[union-attr]
    width_in = 0.5 * (PAGE_IN - 0.9)
    with paper_style():
        figure = new_figure(PAGE_IN, min(0.4 + width_in * shape[0] / shape[1], 4.5), title="")
        axes = figure.subplots(1, 2)
        if gap is None:
            _draw_empty(axes[0], "no images of the sim to compare")
        else:
            _draw_excess(figure, axes[0], gap)
        if force is None:
            _draw_empty(axes[1], "force not placed")
        else:
            _draw_force(figure, axes[1], force)
        return figure


def encode_video_uri(video: VideoComparison) -> str:
    """Encode the three videos side by side as one looping animation (WebP) in a data URI.

    It has 150 frames of 480 pixels at most; small frames are enlarged pixel by pixel.

    Raises:
        ValueError: videos of different shapes, or none that can be encoded.
    """
    if not video.real.shape == video.sim.shape == video.augmented.shape:
        raise ValueError(
            f"videos of shapes {video.real.shape}, {video.sim.shape} and {video.augmented.shape}; "
            "give all three alike"
        )
    stride = -(-len(video.real) // MAX_FRAMES)
    rows = zip(video.real[::stride], video.sim[::stride], video.augmented[::stride], strict=True)
    animation = cv2.Animation()
    animation.frames = [_join_frames(frames) for frames in rows]
    duration_ms = round(1000.0 * stride / video.frames_per_s)
    animation.durations = np.full(len(animation.frames), duration_ms, dtype=np.int32)  # type: ignore[assignment]
    animation.loop_count = 0
    success, encoded = cv2.imencodeanimation(".webp", animation, [cv2.IMWRITE_WEBP_QUALITY, 80])
    if not success:
        raise ValueError(
            f"{len(animation.frames)} frames of {video.real.shape[1:]} could not be encoded as a video"
        )
    return "data:image/webp;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")


def _join_frames(frames: tuple[UInt8[np.ndarray, "H W 3"], ...]) -> UInt8[np.ndarray, "h w 3"]:
    height, width = frames[0].shape[:2]
    scale = MAX_SIDE_PX / max(height, width)
    scale = float(math.floor(scale)) if scale > 1.0 else scale
    interpolation = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    rule = np.full((size[1], RULE_PX, 3), 255, dtype=np.uint8)
    sized = [cv2.resize(frame, size, interpolation=interpolation) for frame in frames]
    joined = np.concatenate([sized[0], rule, sized[1], rule, sized[2]], axis=1)
    return np.ascontiguousarray(joined[..., ::-1])  # OpenCV's order of colours


def _draw_excess(figure: Figure, axis: Any, gap: ImageErrorMap) -> None:
    _draw_background(axis, gap.frame)
    reach = max(float(np.max(gap.excess)), 1e-300)
    shown = np.clip(gap.excess / reach, 0.0, 1.0)
    image = axis.imshow(shown, cmap=IMAGE_COLOURS, alpha=np.clip(1.5 * shown, 0.0, 0.9), vmin=0.0, vmax=1.0)
    for left, top, right, bottom, share in gap.parts:
        corner = (left - 0.5, top - 0.5)
        axis.add_patch(Rectangle(corner, right - left, bottom - top, fill=False, edgecolor=PREDICTED))
        above = top > 0.1 * gap.excess.shape[0]
        annotate(
            axis,
            format_percent(share),
            (left, top if above else bottom),
            offset=(0, 2 if above else -2),
            color=PREDICTED,
            va="bottom" if above else "top",
            fontsize=6,
            path_effects=[Stroke(linewidth=1.5, foreground="white"), Normal()],
        )
    axis.set_title("excess error of the sim's images", loc="left", pad=2)
    add_colorbar(figure, image, axis, "of its maximum", shrink=0.8, aspect=18).outline.set_linewidth(0.5)


def _draw_force(figure: Figure, axis: Any, force: ImageForceMap) -> None:
    _draw_background(axis, force.frame)
    image = axis.scatter(
        *force.points.T,
        c=np.clip(force.explained, 0.0, 1.0),
        cmap=IMAGE_COLOURS,
        s=14,
        vmin=0.0,
        vmax=1.0,
        edgecolors="white",
        linewidths=0.4,
    )
    title = "share that a force on each point explains"
    if force.localisable and len(force.near):
        near = list(force.near)
        longest = max(float(np.linalg.norm(force.forces[near], axis=1).max()), 1e-300)
        length = 0.25 * max(force.frame.shape[:2]) / longest
        arrows = length * force.forces[near]
        axis.quiver(
            *force.points[near].T,
            arrows[:, 0],
            arrows[:, 1],
            angles="xy",
            scale_units="xy",
            scale=1.0,
            color=PREDICTED,
            width=0.01,
            zorder=3,
        )
    else:
        title += "\nnot localisable: the motion does not distinguish the points"
    axis.set_title(title, loc="left", pad=2)
    add_colorbar(figure, image, axis, "share explained", shrink=0.8, aspect=18).outline.set_linewidth(0.5)


def _draw_background(axis: Any, frame: np.ndarray) -> None:
    grey = frame.mean(axis=2) / 255.0
    # Pale, so that colours on it keep their meaning.
    axis.imshow(0.5 + 0.5 * grey, cmap="gray", vmin=0.0, vmax=1.0)
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(True)
    axis.spines[:].set_color(QUIET)


def _draw_empty(axis: Any, text: str) -> None:
    annotate(axis, text, (0.5, 0.5), at="axes fraction", ha="center", color=QUIET)
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


def draw_state_maps(diagnosis: Diagnosis, content: ReportContent) -> Figure | None:
    """Draw the mean residual acceleration over position and velocity, and along one; None without maps."""
    before = list(get_location(diagnosis.where, "maps") or ())
    after = list(content.maps_after)
    shares = get_location(diagnosis.where, "coordinates") or {}
    mapped = {state_map.coordinate for state_map in before}
    order = sorted(mapped, key=lambda i: (-shares.get(get_coordinate_name(diagnosis, i), 0.0), i))[
        :MAX_COORDINATES
    ]
    if not order:
        return None
    columns = 3 if after else 2
    with paper_style():
        figure = new_figure(PAGE_IN, 0.25 + 1.75 * len(order), title="")
        axes = figure.subplots(len(order), columns, squeeze=False)
        for row, at in zip(axes, order, strict=True):
            flat = [
                state_map
                for state_map in before
                if state_map.coordinate == at and len(state_map.velocity_edges) > 2
            ]
            flat_after = [
                state_map
                for state_map in after
                if state_map.coordinate == at and len(state_map.velocity_edges) > 2
            ]
            name = get_coordinate_name(diagnosis, at)
            reach = max(
                (float(np.nanmax(np.abs(state_map.mean))) for state_map in flat[:1] if _has_data(state_map)),
                default=0.0,
            )
            panels = [("sim", flat)] + ([("sim with effects", flat_after)] if after else [])
            image = None
            for axis, (title, maps) in zip(row, panels, strict=False):
                image = _draw_map(axis, maps, reach, name, title) or image
            if regions := (get_location(diagnosis.where, "state_region") or {}).get(name):
                _draw_regions(row[0], regions)
            if image is not None:
                label = f"real − sim ({name}/s²)"
                bar = add_colorbar(figure, image, list(row[: columns - 1]), label, aspect=12)
                bar.outline.set_linewidth(0.5)
            _draw_profile(
                row[-1],
                [state_map for state_map in before if state_map.coordinate == at],
                [state_map for state_map in after if state_map.coordinate == at],
                name,
            )
        return figure


def _has_data(state_map: Any) -> bool:
    return bool(np.isfinite(state_map.mean).any())


def _draw_map(axis: Any, maps: Sequence[Any], reach: float, name: str, title: str) -> Any:
    axis.set_title(title, loc="left", pad=2)
    axis.set(xlabel=name, ylabel=f"{name} rate (1/s)")
    axis.set_facecolor(UNVISITED_COLOUR)
    if not maps or not _has_data(maps[0]):
        annotate(axis, "not computed", (0.5, 0.5), at="axes fraction", ha="center")
        return None
    first = maps[0]
    reach = reach or 1.0
    image = axis.pcolormesh(
        first.position_edges,
        first.velocity_edges,
        np.ma.masked_invalid(first.mean).T,
        cmap=STATE_COLOURS,
        vmin=-reach,
        vmax=reach,
        antialiased=False,
    )
    rows, columns = np.nonzero((np.abs(first.score) > SIGNIFICANT_FROM) & np.isfinite(first.mean))
    middle = [0.5 * (edges[1:] + edges[:-1]) for edges in (first.position_edges, first.velocity_edges)]
    axis.plot(middle[0][rows], middle[1][columns], ".", color="black", markersize=1.5)
    return image


def _draw_regions(axis: Any, regions: Sequence[Any]) -> None:
    """Frame the regions in which the residual keeps its sign."""
    for region in regions:
        position, velocity = region.get("position"), region.get("velocity")
        if not position or not velocity:
            continue
        corner = (position[0], velocity[0])
        size = (position[1] - position[0], velocity[1] - velocity[0])
        axis.add_patch(Rectangle(corner, *size, fill=False, edgecolor="black", linewidth=0.9))


def _draw_profile(axis: Any, before: Sequence[Any], after: Sequence[Any], name: str) -> None:
    """Draw the mean along position or along velocity, whichever the residual varies with more."""
    first = _average_along(before)
    along = max(first, key=lambda key: float(np.ptp(first[key][1])) if len(first[key][1]) else 0.0)
    for marginals, label, color, line in (
        (first, "sim", PREDICTED, (0, (4, 1.5))),
        (_average_along(after) if after else {}, "sim with effects", ENCODED, "-"),
    ):
        if along in marginals:
            _draw_steps(axis, *marginals[along], label, color, line)
    axis.axhline(0.0, color="black", linewidth=0.5)
    axis.set(xlabel=name if along == "position" else f"{name} rate (1/s)", ylabel=f"real − sim ({name}/s²)")
    place_legend_above(axis, 2)


def _average_along(maps: Sequence[Any]) -> dict[str, tuple[np.ndarray, np.ma.MaskedArray]]:
    """Edges and mean residual along position, and along velocity where a map has both."""
    finest = max(maps, key=lambda state_map: len(state_map.velocity_edges))
    mean = np.ma.masked_invalid(finest.mean)
    profiles = {"position": (finest.position_edges, mean.mean(axis=1))}
    if len(finest.velocity_edges) > 2:
        profiles["velocity"] = (finest.velocity_edges, mean.mean(axis=0))
    return profiles


def _draw_steps(
    axis: Any, edges: np.ndarray, mean: np.ma.MaskedArray, label: str, color: str, line: Any
) -> None:
    axis.stairs(
        np.ma.filled(mean.astype(float), np.nan),
        edges,
        baseline=None,
        label=label,
        color=color,
        linestyle=line,
    )
