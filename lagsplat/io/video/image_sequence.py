"""Image sequences for external tools: write the D-NeRF layout, and read predicted frames."""

import json
from pathlib import Path

import cv2
import numpy as np

from lagsplat.array_types import Frames
from lagsplat.io.files.atomic import StrPath, write_text

LISTING = "transforms_train.json"


def write_dnerf(
    folder: StrPath, frames: Frames, *, n_train: int, field_of_view_rad: float, distance: float
) -> float:
    """Write frames as numbered PNGs with one listing; return the time of the train-test split.

    Times run evenly from 0 to 1 over the clip. Frames before the returned time are the first ``n_train``:
    tools that split a listing by time train on these. The one fixed camera is at ``distance`` on the z axis
    and looks along -z at the origin, x to the right, y up.

    Raises:
        ValueError: no frame to train on, or none to predict.
    """
    if not 0 < n_train < len(frames):
        counts = f"{len(frames)} frames, of which {n_train} to train on"
        raise ValueError(f"{counts}: both parts must hold a frame; choose another split")
    place = Path(folder)
    (place / "frames").mkdir(parents=True, exist_ok=True)
    camera = np.eye(4)
    camera[2, 3] = distance
    listed = []
    for index, frame in enumerate(frames):
        name = f"frames/{index:05d}"
        if not cv2.imwrite(str(place / f"{name}.png"), np.asarray(frame)[..., ::-1]):
            raise OSError(f"{place / name}.png: cannot be written; check the disk and the rights")
        time = index / (len(frames) - 1)
        listed.append({"file_path": name, "time": time, "transform_matrix": camera.tolist()})
    listing = {"camera_angle_x": field_of_view_rad, "frames": listed}
    write_text(place / LISTING, json.dumps(listing, indent=1))
    return (n_train - 0.5) / (len(frames) - 1)


def read_predicted(folder: StrPath, *, height: int, width: int, at_least: int) -> Frames:
    """Read the PNGs ``00000.png``, ``00001.png``, ... of a folder, in order: uint8 (N, H, W, 3).

    Raises:
        FileNotFoundError: there is no such folder.
        ValueError: fewer than ``at_least``, a gap in the numbers, an image that is not of ``height`` x
            ``width`` [px] or that cannot be read.
    """
    place = Path(folder)
    if not place.is_dir():
        raise FileNotFoundError(f"{place}: no such folder of predicted frames; check the path")
    files = {int(path.stem): path for path in place.glob("*.png") if path.stem.isdigit()}
    if len(files) < at_least:
        raise ValueError(
            f"{place}: {len(files)} predicted frames, but {at_least} are held out; predict as many"
        )
    first, last = min(files), max(files)
    missing = [number for number in range(first, last + 1) if number not in files]
    if missing:
        lacking = f"{missing[0]:05d}.png is missing ({len(missing)} such)"
        raise ValueError(f"{place}: {first:05d}.png to {last:05d}.png, but {lacking}; copy the folder again")
    pictures = []
    for _, path in sorted(files.items()):
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if picture is None:
            raise ValueError(f"{path}: not a picture that can be read; copy it again")
        if picture.shape[:2] != (height, width):
            size = f"{picture.shape[0]} x {picture.shape[1]} pixels"
            raise ValueError(f"{path}: {size}, but the recording has {height} x {width}; predict that size")
        pictures.append(picture[..., ::-1])
    return np.ascontiguousarray(np.stack(pictures))
