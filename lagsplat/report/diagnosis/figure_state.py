"""Where the gap lies in the image and in the state, and the held-out stretch as a video."""

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.report.common import style
from lagsplat.report.common.formatting import format_percent
from lagsplat.report.diagnosis.content import (
    ImageErrorMap,
    ImageForceMap,
    ReportContent,
    VideoComparison,
    read_location,
)

MAX_SIDE_PX = 480  # of the larger side of a frame
MAX_FRAMES = 150  # of a video, so that a page stays a few megabytes
RULE_PX = 4  # between the frames of a video
IMAGE_COLOURS = "cividis"
MAX_COORDINATES = 2  # coordinates
SIGNIFICANT_FROM = 2.0  # standard errors from which a bin bears a dot
STATE_COLOURS = "PuOr_r"  # for readers with any colour vision, and light in the middle on paper
UNVISITED_COLOUR = "#EEEEEE"


@style.paper_style()
def draw_image_maps(content: ReportContent) -> Figure | None:
    """Draw the excess error over a frame, and how well a force on each point explains the residual.

    None where neither was computed.
    """
    error, force = content.image_error, content.image_force
    frames = [part.frame for part in (error, force) if part is not None]
    if not frames:
        return None
    height, width = frames[0].shape[:2]
    height_in = 0.4 + 0.5 * (style.PAGE_IN - 0.9) * height / width
    figure = style.new_figure(style.PAGE_IN, min(height_in, 4.5))
    axes = figure.subplots(1, 2)
    for axis in axes:
        axis.set(xticks=[], yticks=[])
    if error is None:
        _draw_empty(axes[0], "no images of the sim to compare")
    else:
        _draw_excess(figure, axes[0], error)
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
        raise ValueError(f"{len(animation.frames)} frames of {video.real.shape[1:]} make no video")
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


def _draw_excess(figure: Figure, axis: Any, error: ImageErrorMap) -> None:
    _draw_background(axis, error.frame)
    reach = max(float(np.max(error.excess)), 1e-300)
    shown = np.clip(error.excess / reach, 0.0, 1.0)
    image = axis.imshow(shown, cmap=IMAGE_COLOURS, alpha=np.clip(1.5 * shown, 0.0, 0.9), vmin=0.0, vmax=1.0)
    colour, rim = style.PREDICTED, [Stroke(linewidth=1.5, foreground="white"), Normal()]
    for left, top, right, bottom, share in error.parts:
        corner, text = (left - 0.5, top - 0.5), format_percent(share)
        axis.add_patch(Rectangle(corner, right - left, bottom - top, fill=False, edgecolor=colour))
        above = top > 0.1 * error.excess.shape[0]
        edge, points, side = (top, 2, "bottom") if above else (bottom, -2, "top")
        style.annotate(
            axis, text, (left, edge), (0, points), color=colour, va=side, fontsize=6, path_effects=rim
        )
    axis.set_title("excess error of the sim's images", loc="left", pad=2)
    style.add_colorbar(figure, image, axis, "of its maximum", shrink=0.8, aspect=18)


def _draw_force(figure: Figure, axis: Any, force: ImageForceMap) -> None:
    _draw_background(axis, force.frame)
    shown = np.clip(force.explained, 0.0, 1.0)
    x, y = force.points.T
    image = axis.scatter(x, y, c=shown, cmap=IMAGE_COLOURS, s=14, edgecolors="white", linewidths=0.4)
    image.set_clim(0.0, 1.0)
    title = "share that a force on each point explains"
    if force.localisable and len(force.near):
        near = list(force.near)
        longest = max(float(np.linalg.norm(force.forces[near], axis=1).max()), 1e-300)
        arrows = 0.25 * max(force.frame.shape[:2]) / longest * force.forces[near]
        points, colour = force.points[near].T, style.PREDICTED
        axis.quiver(
            *points, *arrows.T, angles="xy", scale_units="xy", scale=1.0, color=colour, width=0.01, zorder=3
        )
    else:
        title += "\nnot localisable: the motion does not distinguish the points"
    axis.set_title(title, loc="left", pad=2)
    style.add_colorbar(figure, image, axis, "share explained", shrink=0.8, aspect=18)


def _draw_background(axis: Any, frame: np.ndarray) -> None:
    grey = frame.mean(axis=2) / 255.0
    # Pale, so that colours on it keep their meaning.
    axis.imshow(0.5 + 0.5 * grey, cmap="gray", vmin=0.0, vmax=1.0)
    axis.spines[:].set(visible=True, color=style.QUIET)


def _draw_empty(axis: Any, text: str) -> None:
    style.annotate(axis, text, (0.5, 0.5), xycoords="axes fraction", ha="center", color=style.QUIET)
    axis.spines[:].set_visible(False)


@style.paper_style()
def draw_state_maps(diagnosis: Diagnosis) -> Figure | None:
    """Draw the mean residual acceleration over position and velocity, and along one; None without maps."""
    location = read_location(diagnosis)
    maps, shares = location.get("maps") or (), location.get("coordinates") or {}
    names = {state_map.coordinate: diagnosis.q_names[state_map.coordinate] for state_map in maps}
    mapped = sorted(names, key=lambda i: (-shares.get(names[i], 0.0), i))[:MAX_COORDINATES]
    if not mapped:
        return None
    figure = style.new_figure(style.PAGE_IN, 0.25 + 1.75 * len(mapped))
    axes = figure.subplots(len(mapped), 2, squeeze=False)
    for (left, right), coordinate in zip(axes, mapped, strict=True):
        name = names[coordinate]
        own = [state_map for state_map in maps if state_map.coordinate == coordinate]
        image = _draw_map(left, [each for each in own if len(each.velocity_edges) > 2], name)
        for region in (location.get("state_region") or {}).get(name, ()):
            _draw_region(left, region)
        if image is not None:
            style.add_colorbar(figure, image, [left], f"real − sim ({name}/s²)", aspect=12)
        _draw_profile(right, max(own, key=lambda each: len(each.velocity_edges)), name)
    return figure


def _draw_map(axis: Any, maps: Sequence[Any], name: str) -> Any:
    axis.set_title("sim", loc="left", pad=2)
    axis.set(xlabel=name, ylabel=f"{name} rate (1/s)")
    axis.set_facecolor(UNVISITED_COLOUR)
    if not maps or not np.isfinite(maps[0].mean).any():
        style.annotate(axis, "not computed", (0.5, 0.5), xycoords="axes fraction", ha="center")
        return None
    x, y, mean = maps[0].position_edges, maps[0].velocity_edges, maps[0].mean
    reach = float(np.nanmax(np.abs(mean))) or 1.0
    values = np.ma.masked_invalid(mean).T
    image = axis.pcolormesh(x, y, values, cmap=STATE_COLOURS, vmin=-reach, vmax=reach, antialiased=False)
    rows, columns = np.nonzero((np.abs(maps[0].score) > SIGNIFICANT_FROM) & np.isfinite(mean))
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (x, y)]
    axis.plot(middles[0][rows], middles[1][columns], ".", color="black", markersize=1.5)
    return image


def _draw_region(axis: Any, region: Mapping[str, Any]) -> None:
    """Frame a region in which the residual keeps its sign."""
    position, velocity = region.get("position"), region.get("velocity")
    if position and velocity:
        size = (position[1] - position[0], velocity[1] - velocity[0])
        corner = (position[0], velocity[0])
        axis.add_patch(Rectangle(corner, *size, fill=False, edgecolor="black", linewidth=0.9))


def _draw_profile(axis: Any, finest: Any, name: str) -> None:
    """Draw the mean along position or along velocity, whichever the residual varies with more."""
    mean = np.ma.masked_invalid(finest.mean)
    profiles = [(finest.position_edges, mean.mean(axis=1), name)]
    if len(finest.velocity_edges) > 2:
        profiles.append((finest.velocity_edges, mean.mean(axis=0), f"{name} rate (1/s)"))
    edges, values, label = max(profiles, key=lambda profile: float(np.ptp(profile[1])))
    values = np.ma.filled(values.astype(float), np.nan)
    axis.stairs(values, edges, baseline=None, label="sim", color=style.PREDICTED, linestyle=(0, (4, 1.5)))
    axis.axhline(0.0, color="black", linewidth=0.5)
    axis.set(xlabel=label, ylabel=f"real − sim ({name}/s²)")
    style.place_legend_above(axis, 2)
