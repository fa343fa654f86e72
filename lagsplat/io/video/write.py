"""Write images as small videos: MP4 with OpenCV, GIF with Pillow."""

from collections.abc import Iterable

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
        ValueError: there is no image, or OpenCV cannot write such a video here.
    """
    with replace_atomically(path) as temporary:
        writer = None
        for picture in pictures:
            height, width = (2 * (side // 2) for side in picture.shape[:2])
            if writer is None:
                codec = cv2.VideoWriter.fourcc(*"mp4v")
                writer = cv2.VideoWriter(str(temporary), codec, rate_hz, (width, height))
            writer.write(np.ascontiguousarray(picture[:height, :width, ::-1]))
        if writer is None or not writer.isOpened():
            raise ValueError(f"{path}: no film of these pictures can be written; is there one, and a codec?")
        writer.release()


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
