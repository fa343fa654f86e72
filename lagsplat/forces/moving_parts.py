"""Moving parts of an image: motion per pixel, points to push, and the outline."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import binary_erosion
from scipy.spatial import KDTree

from lagsplat.array_types import Latent
from lagsplat.forces.grasp import Point
from lagsplat.matter.field import MatterField
from lagsplat.views.camera import project_by_lens

STILL = 0.02  # share of the 98th percentile of all motions below which matter hardly moves
LARGEST = 0.98  # quantile of the motions that is taken as the largest
RIM_PX = 2  # width of the rim
COVERED = 0.8  # distance of a pixel from the material point that it shows [px]: these are a pixel apart
LEAST_LEVER = 0.25  # of the typical motion, from which a push at a lever turns the object; set by hand
MIDDLE = 0.4  # position of the middle along the visible moving length, which begins below the clamp
TIP = 0.85  # position of the tip along the same length


@dataclass(frozen=True)
class MovingParts:
    """Motion of the matter in each pixel at a state; none where there is no matter.

    Args:
        jacobian: motion per whitened unit [px].
        object: pixels that show matter which moves.
    """

    jacobian: Float64[np.ndarray, "H W n d"]
    object: Bool[np.ndarray, "H W"]

    @property
    def inner(self) -> Bool[np.ndarray, "H W"]:
        """The object without its rim, which may be background of one colour that seems to move along."""
        cores = (binary_erosion(self.object, iterations=depth) for depth in (RIM_PX, 1))
        return next((core for core in cores if core.any()), self.object)

    @property
    def motion(self) -> Float64[np.ndarray, "H W"]:
        """Size of the motion [px per whitened unit]."""
        return np.linalg.norm(self.jacobian, axis=(2, 3))


def find_moving_parts(
    matter: MatterField, q: Latent, *, height: int, width: int, lens: Sequence[float] | None = None
) -> MovingParts:
    """Find the matter that each pixel shows at a state.

    Args:
        matter: of a run.
        q: the state.
        height, width: of the image [px].
        lens: focal lengths and principal point (x, y, x, y) [px] of the recording camera, for matter in
            space.
    """
    places, slopes = matter.carry(q[None])[0].numpy(), matter.jacobian(q).numpy()
    if lens is not None:
        places = project_by_lens(places, lens)
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    distance, nearest = KDTree(places).query(np.stack([columns, rows], 2))
    jacobian = np.where((distance <= COVERED)[:, :, None, None], slopes[nearest], 0.0)
    motion = np.linalg.norm(slopes, axis=(1, 2))
    moves = (motion > STILL * np.quantile(motion, LARGEST))[nearest]
    return MovingParts(jacobian, (distance <= COVERED) & moves)


def has_levers(scene: MovingParts) -> bool:
    """Whether the object turns enough to be pushed at a lever: some of it goes down, and some up.

    Both must move by `LEAST_LEVER` of the typical motion. A bob on a thread hardly turns, and goes to the
    side wherever it is pushed.
    """
    if not scene.object.any():
        return False
    typical = np.median(scene.motion[scene.object])
    return all(reach > LEAST_LEVER * typical for reach in _measure_reach(scene, scene.object).values())


def choose_lever_points(scene: MovingParts, *, margin: float) -> list[Point]:
    """Choose three points of growing lever on one side of the centre of rotation and one on the other.

    The lever is the downward motion per unit of the first coordinate. Points lie on the object, at least
    ``margin`` [px] from the image's edge, near the middle of its rows.

    Raises:
        ValueError: nothing moves up or down on both sides.
    """
    usable = scene.object & _inside(scene.object.shape, margin)
    far = _measure_reach(scene, usable)
    if not all(far.values()):
        raise ValueError("the object has no lever arms: no side moves down while the other moves up")
    wanted = [-share * far[-1] for share in (0.35, 0.65, 1.0)] + [far[1]]
    return _choose_points(scene.jacobian[:, :, 1, 0], wanted, usable)


def choose_moving_points(scene: MovingParts, *, margin: float) -> list[Point]:
    """Choose points that move little, as most do and much, at least ``margin`` [px] from the image's edge.

    Raises:
        ValueError: nothing moves there.
    """
    usable = scene.inner & _inside(scene.object.shape, margin)
    if not usable.any():
        raise ValueError(f"nothing moves that is {margin:.1f} px from the edge of the image; check stage 1")
    return _choose_points(scene.motion, np.quantile(scene.motion[usable], (0.05, 0.5, 0.95)), usable)


def _measure_reach(scene: MovingParts, usable: Bool[np.ndarray, "H W"]) -> dict[int, float]:
    """How far pixels move down and up per unit of the first coordinate, nineteen in twenty at most."""
    lever = scene.jacobian[:, :, 1, 0]
    sides = {side: side * lever[usable & (side * lever > 0)] for side in (-1, 1)}
    return {side: float(np.quantile(moved, 0.95)) if len(moved) else 0.0 for side, moved in sides.items()}


def _choose_points(
    values: Float64[np.ndarray, "H W"], wanted: Iterable[float], usable: Bool[np.ndarray, "H W"]
) -> list[Point]:
    """Pixels of some values, near the middle of the rows that are usable."""
    middle = np.median(np.nonzero(usable)[0])
    rows = np.abs(np.arange(len(values)) - middle)[:, None] / len(values)
    largest = np.abs(values[usable]).max()
    points = []
    for value in wanted:
        score = np.where(usable, np.abs(values - value) / largest + 0.3 * rows, np.inf)
        row, column = np.unravel_index(int(score.argmin()), score.shape)
        points.append((float(column) + 0.5, float(row) + 0.5))
    return points


def choose_background_points(object: Bool[np.ndarray, "H W"], count: int, *, margin: float) -> list[Point]:
    """Choose up to ``count`` pixels far from each other, the object and the edge."""
    rows, columns = np.nonzero(~object & _inside(object.shape, margin))
    apart = _distance(rows, columns, np.argwhere(object))
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
