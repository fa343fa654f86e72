"""Write images as small videos: MP4 with OpenCV, GIF with Pillow."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from lagsplat.io.files.atomic import StrPath, replace_atomically

Picture = UInt8[np.ndarray, "H W 3"]
COLORS = 128


def save_mp4(path: StrPath, pictures: Iterable[Picture], *, rate_hz: float) -> None:
    """Write RGB images of one size as an MPEG-4 video; an odd side loses its last pixel.

    Raises:
        ValueError: there is no image.
        OSError: the file cannot be written.
    """
    with replace_atomically(path) as temporary:
        writer, given = None, 0
        for given, picture in enumerate(pictures, start=1):  # noqa: B007 - the count, after the loop
            height, width = (2 * (side // 2) for side in picture.shape[:2])
            if writer is None:
                codec = cv2.VideoWriter.fourcc(*"mp4v")
                writer = cv2.VideoWriter(str(temporary), codec, rate_hz, (width, height))
            writer.write(np.ascontiguousarray(picture[:height, :width, ::-1]))
        if writer is None:
            raise ValueError(f"{path}: a film needs a picture")
        writer.release()
        # OpenCV tells of no error while it writes.
        if (written := _count_frames(temporary)) != given:
            raise OSError(
                f"{path} was not written: OpenCV has written {written} of {given} pictures and gives no "
                "reason; is the disk full or failing, or does this OpenCV lack MPEG-4?"
            )


def _count_frames(path: Path) -> int:
    film = cv2.VideoCapture(str(path))
    try:
        return sum(iter(film.grab, False))
    finally:
        film.release()


def save_gif(path: StrPath, pictures: Iterable[Picture], *, rate_hz: float) -> None:
    """Write RGB images as an animation that repeats for ever.

    Raises:
        ValueError: there is no image.
    """
    frames = [Image.fromarray(picture).quantize(COLORS) for picture in pictures]
    if not frames:
        raise ValueError(f"{path}: an animation needs a picture")
    # GIF counts hundredths of a second, and browsers slow down animations above 50 Hz.
    pause_ms = 10 * max(2, round(100.0 / rate_hz))
    with replace_atomically(path) as temporary:
        frames[0].save(temporary, save_all=True, append_images=frames[1:], duration=pause_ms, loop=0)
