"""A calibrated rig of real cameras that filmed the same instants, described by a JSON file.

    {"format": "lagsplat rig", "version": 1,
     "reference": "front",                      the camera of the recording
     "pivot_depth": 1.35,                       depth of the mechanism ahead of it
     "cameras": [
       {"name": "front", "width": 1920, "height": 1080,
        "K": [[1500, 0, 960], [0, 1500, 540], [0, 0, 1]],
        "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [0, 0, 0]},
       {"name": "left", "video": "left.mp4", "held_out": false, "width": 1920, ...}, ...]}

OpenCV's convention, as `cv2.calibrateCamera` and `cv2.stereoCalibrate` give it: ``x_camera = R x_world + t``
with x to the right, y down, z ahead; lengths in any one unit; ``K`` in pixels of the ``width`` x ``height``
video. OpenCV counts pixel centres from 0 and this package from 0.5, so reading adds half a pixel to the
principal point. ``video`` is relative to the JSON's folder. A video whose shape differs from its camera's is
refused, and so is lens ``distortion`` other than zeros: undistort videos first, with `cv2.undistort`. A
camera with ``held_out`` only scores the fit.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.views.camera import Camera, ViewSpace

FORMAT, VERSION = "lagsplat rig", 1
SEE = "see lagsplat/views/rig.py for the form"


@dataclass(frozen=True)
class RigCamera:
    """A camera of a rig; ``video`` is None for the recording's own."""

    name: str
    camera: Camera
    video: Path | None
    held_out: bool


@dataclass(frozen=True)
class Rig:
    """The cameras beside the reference, and the coordinates that the reference defines."""

    others: tuple[RigCamera, ...]
    space: ViewSpace


def read_rig(path: str | os.PathLike[str]) -> Rig:
    """Read a rig from its JSON file.

    Raises:
        FileNotFoundError: the file, or the video of a camera, does not exist.
        ValueError: a key is missing or wrong; names the camera and the key.
    """
    file = Path(path).expanduser()
    try:
        return _parse_rig(json.loads(file.read_text(encoding="utf-8")), file.parent)
    except json.JSONDecodeError as error:
        raise ValueError(f"{file}: not JSON ({error}); {SEE}") from error
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def _parse_rig(content: Any, folder: Path) -> Rig:
    if not isinstance(content, dict) or (content.get("format"), content.get("version")) != (FORMAT, VERSION):
        head = f'{{"format": "{FORMAT}", "version": {VERSION}, ...}}'
        raise ValueError(f"not a rig of version {VERSION}; begin it with {head}")
    cameras = [_parse_camera(values, folder) for values in _get(content, "cameras")]
    names = [each.name for each in cameras]
    if len(set(names)) != len(names):
        raise ValueError(f"cameras are called {names}; give each a name of its own")
    reference = _get(content, "reference")
    if reference not in names:
        raise ValueError(f"the reference {reference!r} is none of the cameras {names}")
    camera = cameras.pop(names.index(reference)).camera
    if missing := [each.name for each in cameras if each.video is None]:
        raise ValueError(f"no video of {missing}; only the reference {reference!r} needs none")
    if not cameras:
        raise ValueError(f"{reference!r} is the only camera; a rig has two or more")
    return Rig(tuple(cameras), ViewSpace(camera, float(_get(content, "pivot_depth"))))


def _parse_camera(values: Any, folder: Path) -> RigCamera:
    name = str(_get(values, "name"))
    if any(values.get("distortion") or []):
        raise ValueError(
            f"camera {name!r} has lens distortion {values['distortion']}; undistort its video with "
            "cv2.undistort, give the new K and leave distortion out"
        )
    lens, turn, shift = (_matrix(values, name, key) for key in ("K", "R", "t"))
    if lens.shape != (3, 3) or turn.shape != (3, 3) or shift.shape != (3,):
        raise ValueError(f"camera {name!r} needs K and R of 3 x 3 and t of 3 numbers")
    if abs(lens[0, 1]) > 1e-6 * lens[0, 0] or not np.allclose(lens[2], [0, 0, 1]) or lens[1, 0]:
        raise ValueError(f"K of camera {name!r} is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    focal, middle = (float(lens[0, 0]), float(lens[1, 1])), (float(lens[0, 2]) + 0.5, float(lens[1, 2]) + 0.5)
    height, width = int(_get(values, "height")), int(_get(values, "width"))
    try:
        camera = Camera(turn, -turn.T @ shift, focal, middle, height, width)
    except ValueError as error:
        raise ValueError(f"camera {name!r}: {error}") from error
    video = folder / str(values["video"]) if values.get("video") else None
    if video is not None and not video.exists():
        raise FileNotFoundError(f"camera {name!r}: no video {video}")
    return RigCamera(name, camera, video, bool(values.get("held_out", False)))


def _get(values: Any, key: str) -> Any:
    if not isinstance(values, dict) or key not in values:
        name = values.get("name", "a camera") if isinstance(values, dict) else "a camera"
        raise ValueError(f"{key!r} is missing in {name!r}; {SEE}")
    return values[key]


def _matrix(values: dict[str, Any], name: str, key: str) -> np.ndarray:
    value = _get(values, key)
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{key} of camera {name!r} is not made of numbers ({error})") from error
