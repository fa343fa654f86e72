"""A clip of one fixed camera in the layout of D-NeRF recordings, for tools that read nothing else."""

import json
import os
from pathlib import Path

import cv2
import numpy as np

from lagsplat.io.atomic import write_text
from lagsplat.shapes import Frames

LISTING = "transforms_train.json"


def write_dnerf(
    folder: str | os.PathLike[str],
    frames: Frames,
    *,
    n_train: int,
    field_of_view_rad: float,
    distance: float,
) -> float:
    """Write frames as numbered PNGs and one listing of them; returns the time that divides them.

    Times run from 0 to 1 over the clip, in order and evenly. Every frame has the same camera, at ``distance``
    on the z axis, looking at the origin along -z with x to the right and y up. Frames before the returned
    time are the first ``n_train``: tools that split one listing by time train on these.

    Raises:
        ValueError: nothing is left to train on, or nothing to predict.
    """
    if not 0 < n_train < len(frames):
        raise ValueError(
            f"{len(frames)} frames, of which {n_train} to train on: both parts must hold a frame; choose "
            "another split"
        )
    place = Path(folder)
    (place / "frames").mkdir(parents=True, exist_ok=True)
    camera = np.eye(4)
    camera[2, 3] = distance
    listed = []
    for index, frame in enumerate(frames):
        name = f"frames/{index:05d}"
        written = cv2.imwrite(str(place / f"{name}.png"), np.asarray(frame)[..., ::-1])
        if not written:
            raise OSError(
                f"{place / name}.png: cannot be written; check the disk and the rights of the folder"
            )
        listed.append(
            {
                "file_path": name,
                "time": index / (len(frames) - 1),
                "transform_matrix": camera.tolist(),
            }
        )
    listing = {"camera_angle_x": field_of_view_rad, "frames": listed}
    write_text(place / LISTING, json.dumps(listing, indent=1))
    return (n_train - 0.5) / (len(frames) - 1)
