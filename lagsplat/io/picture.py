"""From a decoded picture to a frame of a recording: turned, cropped, averaged over areas, RGB."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}
HALVED_FROM = 4.0  # pixels of the picture to one of the frame, from which halving first cannot be seen


def shape_picture(
    picture: UInt8[np.ndarray, "h w 3"],
    *,
    crop: Sequence[int] | None,
    size: tuple[int, int] | None,
    source: str,
    grey: bool = False,
) -> UInt8[np.ndarray, "H W 3"]:
    """The RGB frame that a BGR ``picture`` becomes.

    ``crop`` is (x, y, width, height) [pixel]; None keeps the whole picture. ``size`` is (height, width) after
    averaging over areas; None keeps the cropped size. ``grey`` gives three equal channels, the luma of
    ITU-R BT.601: a recording is RGB in any case. ``source`` names the picture in errors.

    Raises:
        ValueError: the crop reaches outside the picture.
    """
    rows, columns = picture.shape[:2]
    x, y, width, height = crop if crop is not None else (0, 0, columns, rows)
    if min(x, y) < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
        raise ValueError(
            f"{source}: crop {[x, y, width, height]} (x, y, width, height) reaches outside the picture, "
            f"which is {columns} wide and {rows} high; make it smaller"
        )
    picture = picture[y : y + height, x : x + width]
    if size is not None:
        picture = average_areas(picture, size)
    if grey:
        return cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2RGB)
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def turn_picture(picture: UInt8[np.ndarray, "h w 3"], degrees: int) -> UInt8[np.ndarray, "H W 3"]:
    """``picture`` turned clockwise by 0, 90, 180 or 270 ``degrees``."""
    return cv2.rotate(picture, TURNS[degrees]) if degrees else picture


def average_areas(picture: UInt8[np.ndarray, "h w *c"], size: tuple[int, int]) -> UInt8[np.ndarray, "H W *c"]:
    """``picture`` resized to ``size`` (height, width) by averaging over areas.

    Even sides that shrink fourfold or more are halved first, by whole pixels: OpenCV does that many times
    faster than by fractions of pixels, and frames of noise differ by less than one of 255 levels on average.
    """
    rows, columns = picture.shape[:2]
    if not rows % 2 and not columns % 2 and min(rows / size[0], columns / size[1]) >= HALVED_FROM:
        picture = cv2.resize(picture, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
    return cv2.resize(picture, (size[1], size[0]), interpolation=cv2.INTER_AREA)
