"""A few small grey pictures of a film of unknown length, evenly spaced, gathered while it is decoded."""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from lagsplat.io.picture import average_areas

MOST = 300
LONGEST_SIDE = 160  # pixels


class Thumbnails:
    """At most 300 pictures of at most 160 pixels a side, the first one among them.

    Every k-th picture is kept; whenever there are too many, every other one goes and k doubles.
    """

    def __init__(self) -> None:
        self.pictures: list[UInt8[np.ndarray, "h w"]] = []
        """The thumbnails, grey, in order."""
        self._every, self._seen = 1, 0
        self.scale = 1.0
        """Pixels of the picture to one of the thumbnail."""
        self.width = 0
        """Of the pictures [pixel]."""

    def add(self, picture: UInt8[np.ndarray, "H W 3"]) -> None:
        """Keep ``picture`` (BGR) if its turn has come."""
        if self._seen % self._every == 0:
            self.width = picture.shape[1]
            self.scale = max(1.0, max(picture.shape[:2]) / LONGEST_SIDE)
            size = (round(picture.shape[0] / self.scale), round(picture.shape[1] / self.scale))
            small = cv2.cvtColor(
                average_areas(picture, (max(1, size[0]), max(1, size[1]))), cv2.COLOR_BGR2GRAY
            )
            self.pictures.append(small)
        self._seen += 1
        if len(self.pictures) > MOST:
            self.pictures = self.pictures[::2]
            self._every *= 2


def small_grey(frames: UInt8[np.ndarray, "T H W 3"], *, most: int) -> Float32[np.ndarray, "T h w"]:
    """All ``frames``, grey and so small that they hold ``most`` pixels together and 160 a side."""
    rows, columns = frames.shape[1:3]
    scale = max(1.0, max(rows, columns) / LONGEST_SIDE, (len(frames) * rows * columns / most) ** 0.5)
    size = (max(1, round(rows / scale)), max(1, round(columns / scale)))
    small = np.empty((len(frames), *size), np.float32)
    for i, frame in enumerate(frames):
        grey = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY).astype(np.float32)
        small[i] = grey if scale == 1.0 else cv2.resize(grey, size[::-1], interpolation=cv2.INTER_AREA)
    return small
