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
        content = json.loads(file.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{file}: not JSON ({error}); see lagsplat/views/rig.py for the form") from error
    if not isinstance(content, dict) or (content.get("format"), content.get("version")) != (FORMAT, VERSION):
        raise ValueError(f"{file}: not a rig of version {VERSION}; begin it with {_HEAD}")
    cameras = [_camera(file, values) for values in _get(file, content, "cameras")]
    names = [each.name for each in cameras]
    if len(set(names)) != len(names):
        raise ValueError(f"{file}: cameras are called {names}; give each a name of its own")
    reference = _get(file, content, "reference")
    if reference not in names:
        raise ValueError(f"{file}: the reference {reference!r} is none of the cameras {names}")
    others = tuple(each for each in cameras if each.name != reference)
    if missing := [each.name for each in others if each.video is None]:
        raise ValueError(f"{file}: no video of {missing}; only the reference {reference!r} needs none")
    if not others:
        raise ValueError(f"{file}: {reference!r} is the only camera; a rig has two or more")
    camera = next(each.camera for each in cameras if each.name == reference)
    return Rig(others, ViewSpace(camera, float(_get(file, content, "pivot_depth"))))


_HEAD = f'{{"format": "{FORMAT}", "version": {VERSION}, ...}}'


def _camera(file: Path, values: dict[str, Any]) -> RigCamera:
    name = str(_get(file, values, "name"))
    if any(values.get("distortion") or []):
        raise ValueError(
            f"{file}: camera {name!r} has lens distortion {values['distortion']}; undistort its video with "
            "cv2.undistort, give the new K and leave distortion out"
        )
    lens, turn, shift = (_matrix(file, name, values, key) for key in ("K", "R", "t"))
    if lens.shape != (3, 3) or turn.shape != (3, 3) or shift.shape != (3,):
        raise ValueError(f"{file}: camera {name!r} needs K and R of 3 x 3 and t of 3 numbers")
    if abs(lens[0, 1]) > 1e-6 * lens[0, 0] or not np.allclose(lens[2], [0, 0, 1]) or lens[1, 0]:
        raise ValueError(f"{file}: K of camera {name!r} is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    try:
        camera = Camera(
            rotation=turn,
            position=-turn.T @ shift,
            focal=(float(lens[0, 0]), float(lens[1, 1])),
            middle=(float(lens[0, 2]) + 0.5, float(lens[1, 2]) + 0.5),
            height=int(_get(file, values, "height")),
            width=int(_get(file, values, "width")),
        )
    except ValueError as error:
        raise ValueError(f"{file}: camera {name!r}: {error}") from error
    video = file.parent / str(values["video"]) if values.get("video") else None
    if video is not None and not video.exists():
        raise FileNotFoundError(f"{file}: camera {name!r}: no video {video}")
    return RigCamera(name, camera, video, bool(values.get("held_out", False)))


def _get(file: Path, values: Any, key: str) -> Any:
    if not isinstance(values, dict) or key not in values:
        name = values.get("name", "a camera") if isinstance(values, dict) else "a camera"
        raise ValueError(f"{file}: {key!r} is missing in {name!r}; see lagsplat/views/rig.py for the form")
    return values[key]


def _matrix(file: Path, name: str, values: dict[str, Any], key: str) -> np.ndarray:
    try:
        return np.array(_get(file, values, key), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{file}: {key} of camera {name!r} is not made of numbers ({error})") from error
