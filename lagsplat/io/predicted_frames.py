"""Numbered pictures that another program predicted."""

import os
from pathlib import Path

import cv2
import numpy as np

from lagsplat.shapes import Frames


def read_predicted(folder: str | os.PathLike[str], *, height: int, width: int, at_least: int) -> Frames:
    """The PNGs ``00000.png``, ``00001.png``, ... of a folder in the order of their numbers, uint8 (N,H,W,3).

    Raises:
        FileNotFoundError: there is no such folder.
        ValueError: fewer than ``at_least`` of them, a gap in the numbers, a picture of another size or one
        that cannot be read.
    """
    place = Path(folder)
    if not place.is_dir():
        raise FileNotFoundError(f"{place}: no such folder of predicted frames; check the path")
    files = sorted(
        (path for path in place.glob("*.png") if path.stem.isdigit()), key=lambda path: int(path.stem)
    )
    if len(files) < at_least:
        raise ValueError(
            f"{place}: {len(files)} predicted frames, but {at_least} are held out; let the tool predict as "
            "many, or check which folder was given"
        )
    numbers = [int(path.stem) for path in files]
    missing = sorted(set(range(numbers[0], numbers[-1] + 1)) - set(numbers))
    if missing:
        raise ValueError(
            f"{place}: {numbers[0]:05d}.png to {numbers[-1]:05d}.png, but {missing[0]:05d}.png is missing "
            f"({len(missing)} such); copy the folder again"
        )
    pictures = []
    for path in files:
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if picture is None:
            raise ValueError(f"{path}: not a picture that can be read; copy it again")
        if picture.shape[:2] != (height, width):
            size = f"{picture.shape[0]} x {picture.shape[1]}"
            raise ValueError(
                f"{path}: {size} pixels, but the recording has {height} x {width}; predict frames of the "
                "recording's size (the tool does not resize what it is given)"
            )
        pictures.append(picture[..., ::-1])
    return np.ascontiguousarray(np.stack(pictures))
