"""Novel views of a recording's instants: images, their known pixels and their cameras; views from a rig."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.io.recording.recording import Recording
from lagsplat.io.video.clips import find_clips
from lagsplat.io.video.decode import read_frame_size
from lagsplat.views.camera import Camera, ViewSpace
from lagsplat.views.rig import Rig

KIND, SCHEMA = "views", 1
KNOWN = 0.5  # cover above which a pixel is known; below it there is a hole


@dataclass(frozen=True)
class NovelViews:
    """Images (T, V, H, W, 3) by V cameras at a recording's T instants.

    The recording's own camera is the reference of ``space``. ``cover`` (T, V, H, W) in [0, 255] is the known
    share of a pixel, None if all is known. Training sees all cameras except ``held_out``, which score it.

    Raises:
        ValueError: images, cover, cameras and names do not match.
    """

    images: UInt8[np.ndarray, "T V H W 3"]
    cover: UInt8[np.ndarray, "T V H W"] | None
    cameras: tuple[Camera, ...]
    names: tuple[str, ...]
    held_out: Bool[np.ndarray, " V"]
    space: ViewSpace

    def __post_init__(self) -> None:
        count, height, width = self.images.shape[1:4]
        if not len(self.cameras) == len(self.names) == len(self.held_out) == count:
            raise ValueError(
                f"{count} images an instant, but {len(self.cameras)} cameras, {len(self.names)} names and "
                f"{len(self.held_out)} marks of what is held out: give one of each per image"
            )
        for name, camera in zip(self.names, self.cameras, strict=True):
            _require_size(camera, (height, width), f"camera {name!r}", "its images")
        if self.cover is not None and self.cover.shape != self.images.shape[:4]:
            raise ValueError(f"cover of shape {self.cover.shape} for images of shape {self.images.shape}")
        if self.held_out.all():
            raise ValueError(f"all {count} cameras are held out; leave some to train on")

    @property
    def seen(self) -> tuple[int, ...]:
        """Indices of the cameras that training sees."""
        return tuple(np.flatnonzero(~self.held_out).tolist())

    def first(self, count: int) -> "NovelViews":
        """The views of the first ``count`` instants."""
        cover = None if self.cover is None else self.cover[:count]
        return replace(self, images=self.images[:count], cover=cover)


def require_views(views: NovelViews, frames: UInt8[np.ndarray, "T H W 3"]) -> None:
    """Raise a ValueError unless views have these frames' instants and the size of their reference camera."""
    count, height, width, _ = frames.shape
    instants = len(views.images)
    if instants != count:
        raise ValueError(f"views of {instants} instants for {count} frames: make them from this recording")
    _require_size(views.space.reference, (height, width), "the views' reference camera", "the frames")


def _require_size(camera: Camera, size: tuple[int, int], who: str, images: str) -> None:
    if (camera.height, camera.width) != size:
        raise ValueError(
            f"{who} is of {camera.height} x {camera.width} pixels and {images} of {size[0]} x {size[1]}: "
            "make or calibrate one of them again, for the size of the other"
        )


def save_views(path: str | os.PathLike[str], views: NovelViews, header: Mapping[str, Any]) -> None:
    """Save ``views`` as an artifact of kind ``views``."""
    tensors = {"images": views.images, "held_out": views.held_out}
    if views.cover is not None:
        tensors["cover"] = views.cover
    about = {
        "names": views.names,
        "cameras": [asdict(camera) for camera in views.cameras],
        "reference": asdict(views.space.reference),
        "depth": views.space.depth,
    }
    save_artifact(path, tensors, {**header, **about, "kind": KIND, "schema": SCHEMA})


def load_views(path: str | os.PathLike[str]) -> NovelViews:
    """Load the views at ``path``, errors as `load_artifact`; images are a read-only memory map."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA, mapped=("images",))
    cameras = tuple(_read_camera(values) for values in header["cameras"])
    space = ViewSpace(_read_camera(header["reference"]), header["depth"])
    names, cover = tuple(header["names"]), tensors.get("cover")
    return NovelViews(tensors["images"], cover, cameras, names, tensors["held_out"], space)


def _read_camera(values: Mapping[str, Any]) -> Camera:
    """Rebuild a camera from the output of `dataclasses.asdict`."""
    pose = {key: np.array(values[key], dtype=np.float64) for key in ("rotation", "position")}
    lens = {key: tuple(float(value) for value in values[key]) for key in ("focal", "middle")}
    return Camera(**{**values, **pose, **lens})


def cameras_bytes(cameras: Sequence[Camera]) -> bytes:
    """All parameters of the cameras as bytes, for a digest."""
    rows = [[*c.rotation.ravel(), *c.position, *c.focal, *c.middle, c.height, c.width] for c in cameras]
    return np.array(rows, dtype=np.float64).tobytes()


def collect_filmed_views(
    rig: Rig, recording: Recording, video: Path, read: Callable[[Path], Recording]
) -> NovelViews:
    """Read the videos of the rig's other cameras as views of the recording, which comes from ``video``.

    ``read`` reads another video with the recording's settings and size.

    Raises:
        ValueError: a video has another size than its camera, or other instants than the recording.
    """
    _require_size(rig.space.reference, _frame_size(video), "the reference", str(video))
    spacing, since_first = float(np.median(np.diff(recording.time_s))), recording.time_s - recording.time_s[0]
    images = []
    for each in rig.others:
        assert each.video is not None, "the rig names a video for every other camera"
        who = f"camera {each.name!r}"
        _require_size(each.camera, _frame_size(each.video), who, str(each.video))
        other = read(each.video)
        if other.n_frames != recording.n_frames:
            both = f"{other.n_frames} frames and the reference {recording.n_frames}"
            raise ValueError(f"{who} has {both}; cut both to the same instants")
        off = float(np.abs(other.time_s - other.time_s[0] - since_first).max())
        if off > 0.5 * spacing:
            raise ValueError(
                f"{who} is up to {off:.4f} s off the reference, whose frames are {spacing:.4f} s apart; the "
                "cameras of a rig must be synchronous"
            )
        images.append(np.asarray(other.frames))
    height, width = recording.height, recording.width
    cameras = tuple(each.camera.resized(height, width) for each in rig.others)
    names, held_out = zip(*((each.name, each.held_out) for each in rig.others), strict=True)
    space = rig.space.resized(height, width)
    return NovelViews(np.stack(images, axis=1), None, cameras, names, np.array(held_out), space)


def _frame_size(video: Path) -> tuple[int, int]:
    return read_frame_size(find_clips(video)[0], dt_s=None)
