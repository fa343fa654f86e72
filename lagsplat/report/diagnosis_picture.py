"""Where on the picture the gap lies, and the stretch itself as a film."""

import base64
import math
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke

from lagsplat.report.diagnosis_exhibits import Exhibits, Film, PictureForce, PictureGap
from lagsplat.report.rounding import percent
from lagsplat.report.style import PAGE_IN, PREDICTED, QUIET, new_figure, paper_style

SIDE = 480  # pixels of a film's larger side at most
FRAMES = 150  # of a film at most: a page stays a few megabytes
RULE = 4  # pixels between the pictures of a film
COLOURS = "cividis"


def draw_picture(exhibits: Exhibits) -> Figure | None:
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


def film_uri(film: Film) -> str:
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
    stride = -(-len(film.real) // FRAMES)
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
    scale = SIDE / max(height, width)
    scale = float(math.floor(scale)) if scale > 1.0 else scale
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    rule = np.full((size[1], RULE, 3), 255, dtype=np.uint8)
    sized = [cv2.resize(one, size, interpolation=way) for one in pictures]
    joined = np.concatenate([sized[0], rule, sized[1], rule, sized[2]], axis=1)
    return np.ascontiguousarray(joined[..., ::-1])  # OpenCV's order of colours


def _excess(figure: Figure, axis: Any, gap: PictureGap) -> None:
    _ground(axis, gap.picture)
    reach = max(float(np.max(gap.excess)), 1e-300)
    shown = np.clip(gap.excess / reach, 0.0, 1.0)
    picture = axis.imshow(shown, cmap=COLOURS, alpha=np.clip(1.5 * shown, 0.0, 0.9), vmin=0.0, vmax=1.0)
    for left, top, right, bottom, share in gap.parts:
        corner = (left - 0.5, top - 0.5)
        axis.add_patch(Rectangle(corner, right - left, bottom - top, fill=False, edgecolor=PREDICTED))
        above = top > 0.1 * gap.excess.shape[0]
        axis.annotate(
            percent(share), (left, top if above else bottom), (0, 2 if above else -2), color=PREDICTED,
            textcoords="offset points", va="bottom" if above else "top", fontsize=6,
            path_effects=[Stroke(linewidth=1.5, foreground="white"), Normal()],
        )  # fmt: skip
    axis.set_title("excess error of the sim's pictures", loc="left", pad=2)
    _bar(figure, axis, picture, "of its maximum")


def _force(figure: Figure, axis: Any, force: PictureForce) -> None:
    _ground(axis, force.picture)
    picture = axis.scatter(
        *force.points.T, c=np.clip(force.explained, 0.0, 1.0), cmap=COLOURS, s=14, vmin=0.0, vmax=1.0,
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
