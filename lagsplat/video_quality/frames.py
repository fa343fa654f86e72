"""Make frames from the images of a video: rotate, crop, resize; and small copies for measurements."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}
HALVED_FROM = 4.0  # pixels of the image per pixel of the frame, above which halving first is invisible


@dataclass(frozen=True)
class FrameSettings:
    """Which images of a video become frames, and how."""

    crop: Sequence[int] | None = None  # (x, y, width, height) [pixel of the rotated image]
    skip_s: float = 0.0  # keep frames from this time on [s from each clip's first]...
    end_s: float | None = None  # ...up to this one, exclusive
    size: tuple[int, int] | None = None  # (height, width) after averaging over areas
    rotate: int = 0  # clockwise [degree], on top of the file's own tag
    grey: bool = False  # make the three channels equal, the luma of ITU-R BT.601
    stabilise: bool = False  # of videos: shift images back onto the first by the motion of the background
    dt_s: float | None = None  # of videos: spacing [s] of images that have no times


def crop_and_resize(
    picture: UInt8[np.ndarray, "h w 3"], settings: FrameSettings, *, source: str
) -> UInt8[np.ndarray, "H W 3"]:
    """Convert a rotated BGR image to an RGB frame; ``source`` is its name in errors.

    Raises:
        ValueError: the crop reaches outside the image.
    """
    rows, columns = picture.shape[:2]
    x, y, width, height = settings.crop if settings.crop is not None else (0, 0, columns, rows)
    if min(x, y) < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
        raise ValueError(
            f"{source}: crop {[x, y, width, height]} (x, y, width, height) reaches outside the picture, "
            f"which is {columns} wide and {rows} high; make it smaller"
        )
    picture = picture[y : y + height, x : x + width]
    if settings.size is not None:
        picture = average_areas(picture, settings.size)
    if settings.grey:
        return cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2RGB)
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def rotate_image(picture: UInt8[np.ndarray, "h w 3"], degrees: int) -> UInt8[np.ndarray, "H W 3"]:
    """Rotate ``picture`` clockwise by 0, 90, 180 or 270 ``degrees``."""
    return cv2.rotate(picture, TURNS[degrees]) if degrees else picture


def average_areas(picture: UInt8[np.ndarray, "h w *c"], size: tuple[int, int]) -> UInt8[np.ndarray, "H W *c"]:
    """Resize ``picture`` to ``size`` (height, width) by averaging over areas.

    Even sides that shrink fourfold or more are halved first, as OpenCV averages whole pixels many times
    faster than fractions; frames of noise differ by less than one of 255 levels on average.
    """
    rows, columns = picture.shape[:2]
    if not rows % 2 and not columns % 2 and min(rows / size[0], columns / size[1]) >= HALVED_FROM:
        picture = cv2.resize(picture, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
    return cv2.resize(picture, (size[1], size[0]), interpolation=cv2.INTER_AREA)


MOST = 300
LONGEST_SIDE = 160  # pixels


class Thumbnails:
    """At most 300 small images of a video of unknown length, evenly spaced, at most 160 pixels a side.

    Every k-th image is kept, the first included; beyond 300, every other one is dropped and k doubles.
    """

    def __init__(self) -> None:
        self.pictures: list[UInt8[np.ndarray, "h w"]] = []  # grey, in order
        self.scale = 1.0  # pixels of the image per pixel of the thumbnail
        self.height, self.width = 0, 0  # of the images [pixel]
        self._every, self._seen = 1, 0

    def add(self, picture: UInt8[np.ndarray, "H W 3"]) -> None:
        """Keep ``picture`` (BGR) if it is its turn."""
        if self._seen % self._every == 0:
            self.height, self.width = picture.shape[:2]
            self.scale = max(1.0, max(self.height, self.width) / LONGEST_SIDE)
            size = (max(1, round(self.height / self.scale)), max(1, round(self.width / self.scale)))
            self.pictures.append(cv2.cvtColor(average_areas(picture, size), cv2.COLOR_BGR2GRAY))
        self._seen += 1
        if len(self.pictures) > MOST:
            self.pictures = self.pictures[::2]
            self._every *= 2


def make_small_grey(frames: UInt8[np.ndarray, "T H W 3"], *, most: int) -> Float32[np.ndarray, "T h w"]:
    """All ``frames`` in grey, so small that together they have ``most`` pixels, and at most 160 a side."""
    rows, columns = frames.shape[1:3]
    scale = max(1.0, max(rows, columns) / LONGEST_SIDE, (len(frames) * rows * columns / most) ** 0.5)
    size = (max(1, round(rows / scale)), max(1, round(columns / scale)))
    small = np.empty((len(frames), *size), np.float32)
    for i, frame in enumerate(frames):
        grey = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY).astype(np.float32)
        small[i] = grey if scale == 1.0 else cv2.resize(grey, size[::-1], interpolation=cv2.INTER_AREA)
    return small
