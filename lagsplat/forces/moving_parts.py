"""Moving parts of an image: motion per pixel from drawn Jacobians, points to push, and the outline."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from scipy.ndimage import binary_dilation, gaussian_filter, label, maximum_filter

from lagsplat.chart.chart import Chart
from lagsplat.forces.grasp import Point
from lagsplat.stage1.autoencoder import Autoencoder

OUTLINE = 0.5  # share of the largest motion nearby from which a pixel is the object, not the wall beside it
SMOOTH = 0.02  # width of the filter before the segmentation, as a share of the longer side
AROUND = 5  # neighbourhoods along the longer side of the image
LEAST = 0.15  # share of the 98th percentile of all motions: neighbourhoods that move less contain no object
STILL = 0.02  # share of the 98th percentile below which a pixel is background
MIDDLE = 0.4  # position of the middle along the visible moving length, which begins below the clamp
TIP = 0.85  # position of the tip along the same length


@dataclass(frozen=True)
class MovingParts:
    """Motion of the matter in each pixel at a state."""

    jacobian: Float64[np.ndarray, "H W n d"]  # motion per whitened unit [px]
    motion: Float64[np.ndarray, "H W"]  # its norm, relative to the 98th percentile

    @cached_property
    def relative(self) -> Float64[np.ndarray, "H W"]:
        """Motion relative to the largest nearby, near 1 on the object; 0 on other parts that move."""
        smooth = gaussian_filter(self.motion, SMOOTH * max(self.motion.shape))
        around = maximum_filter(smooth, size=max(3, max(self.motion.shape) // AROUND))
        share = smooth / np.maximum(around, LEAST)
        parts, count = label(share > OUTLINE)
        if not count:
            return np.zeros_like(share)
        largest = parts == 1 + np.bincount(parts[parts > 0] - 1).argmax()
        return np.where(binary_dilation(largest), share * (largest | (share <= OUTLINE)), 0.0)

    @property
    def object(self) -> Bool[np.ndarray, "H W"]:
        """Pixels of the object that moves."""
        return self.relative > OUTLINE


@torch.no_grad()
def find_moving_parts(autoencoder: Autoencoder, chart: Chart, q: Float64[np.ndarray, " d"]) -> MovingParts:
    """Draw the Jacobians of the Gaussians in place of their colours, over a background that does not move.

    Compositing is linear in the colours, so each pixel shows the Jacobian of the matter in it.
    """
    model = autoencoder.gaussians
    z = torch.from_numpy(chart.to_raw(q[None])).to(model.center)
    drawn = model.condition(z)
    jacobian = model.jacobian() @ torch.from_numpy(chart.unwhiten).to(model.center).T
    channels = jacobian.flatten(1)
    padded = torch.nn.functional.pad(channels, (0, -channels.shape[1] % 3))
    nothing = torch.zeros_like(drawn.background)
    scenes = [drawn._replace(color=part.contiguous(), background=nothing) for part in padded.split(3, 1)]
    parts = torch.cat([autoencoder.draw(scene)[0] for scene in scenes])
    channels_drawn = parts[: channels.shape[1]].double().cpu().numpy()
    field = np.moveaxis(channels_drawn, 0, 2).reshape(autoencoder.height, autoencoder.width, model.space, -1)
    motion = np.linalg.norm(field, axis=(2, 3))
    return MovingParts(field, motion / max(float(np.quantile(motion, 0.98)), 1e-12))


def choose_lever_points(scene: MovingParts, *, margin: float) -> list[Point]:
    """Choose three points of growing lever on one side of the centre of rotation and one on the other.

    The lever is the downward motion per unit of the first coordinate. Points lie on the object, at least
    ``margin`` [px] from the image's edge, near the middle of its rows.

    Raises:
        ValueError: nothing moves up or down on both sides.
    """
    lever = scene.jacobian[:, :, 1, 0]
    usable = scene.object & _inside(scene.motion.shape, margin)
    if not (usable & (lever > 0)).any() or not (usable & (lever < 0)).any():
        raise ValueError("the object has no lever arms: no side moves down while the other moves up")
    far = {side: float(np.quantile(side * lever[usable & (side * lever > 0)], 0.95)) for side in (-1, 1)}
    wanted = [-share * far[-1] for share in (0.35, 0.65, 1.0)] + [far[1]]
    middle = np.median(np.nonzero(usable)[0])
    rows = np.abs(np.arange(len(lever)) - middle)[:, None] / len(lever)
    points = []
    for value in wanted:
        score = np.where(usable, np.abs(lever - value) / max(far.values()) + 0.3 * rows, np.inf)
        row, column = np.unravel_index(int(score.argmin()), score.shape)
        points.append((float(column) + 0.5, float(row) + 0.5))
    return points


def choose_background_points(scene: MovingParts, count: int, *, margin: float) -> list[Point]:
    """Choose up to ``count`` pixels that do not move, far from each other, the object and the edge."""
    usable = (scene.motion < STILL) & _inside(scene.motion.shape, margin)
    rows, columns = np.nonzero(usable)
    apart = _distance(rows, columns, np.argwhere(scene.object))
    points: list[Point] = []
    for _ in range(min(count, len(rows))):
        best = int(apart.argmax())
        if not apart[best] > margin:
            break
        points.append((columns[best] + 0.5, rows[best] + 0.5))
        apart = np.minimum(apart, _distance(rows, columns, np.array([[rows[best], columns[best]]])))
    return points


def choose_hanging_points(scene: MovingParts) -> tuple[Point, Point, Float64[np.ndarray, "2"]]:
    """Choose the middle and the tip of a hanging object and return the unit direction (x, y) between them.

    The centre line is the mean column of the object in each row. The tip is at `TIP` of its length, because a
    brush at the very end would grasp the background.

    Raises:
        ValueError: nothing moves.
    """
    rows = np.flatnonzero(scene.object.any(1))
    if len(rows) < 3:
        raise ValueError("nothing moves in the image: there is no arm to push; check stage 1")
    weight = np.where(scene.object, scene.motion, 0.0)[rows]
    columns = weight @ (np.arange(weight.shape[1]) + 0.5) / weight.sum(1)
    length = rows[-1] - rows[0]
    middle, tip = (int(np.searchsorted(rows, rows[0] + share * length)) for share in (MIDDLE, TIP))
    points = [(float(columns[i]), float(rows[i]) + 0.5) for i in (middle, tip)]
    along = np.array(points[1]) - np.array(points[0])
    return points[0], points[1], along / np.linalg.norm(along)


def _inside(shape: tuple[int, ...], margin: float) -> Bool[np.ndarray, "H W"]:
    axes = [np.arange(size) + 0.5 for size in shape]
    down, across = ((x >= margin) & (x <= size - margin) for x, size in zip(axes, shape, strict=True))
    return down[:, None] & across


def _distance(rows: np.ndarray, columns: np.ndarray, others: np.ndarray) -> np.ndarray:
    if not len(others):
        return np.full(len(rows), np.inf)
    away = np.hypot(rows[:, None] - others[None, :, 0], columns[:, None] - others[None, :, 1])
    return away.min(1)


CORE = 0.9  # share of the largest motion nearby from which a pixel certainly belongs to the object
CUTS = 5  # iterations of GrabCut
FOREGROUND = (cv2.GC_FGD, cv2.GC_PR_FGD)


def draw_outline(image: Float[np.ndarray, "h w 3"], scene: MovingParts) -> Bool[np.ndarray, "h w"]:
    """Segment the object by colour, starting from its motion; used for figures and outlines only.

    Source: Rother, Kolmogorov and Blake, "GrabCut", ACM Transactions on Graphics 23 (2004), as in OpenCV.
    """
    size, maps = image.shape[1::-1], (scene.relative, scene.motion)
    near, moves = (cv2.resize(each.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) for each in maps)
    labels = np.where(near > OUTLINE, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[near > CORE] = cv2.GC_FGD
    labels[moves < STILL] = cv2.GC_BGD
    if not (np.isin(labels, FOREGROUND).any() and (~np.isin(labels, FOREGROUND)).any()):
        return near > OUTLINE
    cv2.setRNGSeed(0)
    levels = (255 * image.clip(0.0, 1.0)).astype(np.uint8)
    ground, thing = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(levels, labels, (0, 0, 1, 1), ground, thing, CUTS, cv2.GC_INIT_WITH_MASK)
    return np.isin(labels, FOREGROUND)
