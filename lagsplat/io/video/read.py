"""Read videos and folders of images as recordings, with OpenCV.

Images are rotated, stabilised, cropped, resized and checked one by one as they are decoded, so no video is
in memory at full size. Crops are in coordinates of the rotated image.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from lagsplat.io.files.atomic import StrPath, sha256_of
from lagsplat.io.recording.recording import Recording
from lagsplat.io.trajectory.timing import CLIP_GAP_S, lay_out_clocks
from lagsplat.io.video.clips import VideoClip, find_clips
from lagsplat.io.video.decode import (
    count_duplicates_at_start,
    decode_frames,
    overlap_decoding,
    read_frame_size,
)
from lagsplat.provenance import sha256_hex
from lagsplat.video_quality.assessment import assess_video
from lagsplat.video_quality.camera_motion import path_to_undo, shift_back
from lagsplat.video_quality.frames import FrameSettings, Thumbnails, crop_and_resize, rotate_image

Picture = UInt8[np.ndarray, "H W 3"]
SAME_SHAPE = 0.01  # largest relative difference of equal aspect ratios, and of equal frame spacings


@dataclass(frozen=True)
class _Film:
    """One clip as read: frames, their times [s], its quality and other metadata."""

    frames: UInt8[np.ndarray, "T H W 3"]
    time_s: Float64[np.ndarray, " T"]
    footage: dict[str, Any]
    meta: dict[str, Any]


def read_video(path: StrPath, settings: FrameSettings) -> Recording:
    """Read the video, folder of videos or folder of images at ``path``, without inputs.

    Each video of a folder is a clip. Times are those of the container; each later clip is shifted to start 1
    s after the previous one. Leading duplicates are dropped. Defects cause warnings and are kept in
    ``meta["footage"]``, by clip.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: a file cannot be decoded, has no frame in the range, goes backwards in time, is smaller
            than the crop, or its clips differ in shape; the times of images are unknown; or there is no
            background to stabilise on.
    """
    clips = find_clips(path)
    settings = _with_common_size(clips, settings)
    films = [_read_clip(clip, settings) for clip in clips]
    _warn_of_spacings(clips, films)
    stops = np.cumsum([len(film.time_s) for film in films]).tolist()
    digests = [sha256_of(file) for clip in clips for file in clip.files]
    return Recording(
        frames=films[0].frames if len(films) == 1 else np.concatenate([film.frames for film in films]),
        time_s=lay_out_clocks([film.time_s for film in films]),
        inputs=np.zeros((stops[-1], 0)),
        input_names=(),
        input_units=(),
        segments=tuple(pairwise([0, *stops])),
        meta={
            "origin": "filmed",
            "source": Path(path).name,
            "sha256": digests[0] if len(digests) == 1 else sha256_hex("".join(digests).encode()),
            "licence": "unknown",
            "crop": None if settings.crop is None else list(settings.crop),
            "skip_s": settings.skip_s,
            "end_s": settings.end_s,
            "rotate": settings.rotate,
            "grey": settings.grey,
            "stabilise": settings.stabilise,
            "clip_gap_s": CLIP_GAP_S if len(clips) > 1 else None,
            "clips": [film.meta for film in films],
            "footage": [film.footage for film in films],
        },
    )


def _read_clip(clip: VideoClip, settings: FrameSettings) -> _Film:
    source = str(clip.path)
    displacements = iter(_measure_path(clip, settings)) if settings.stabilise else None
    thumbnails = Thumbnails()

    def make_frame(item: tuple[float, UInt8[np.ndarray, "h w 3"] | None]) -> tuple[float, Picture | None]:
        time_s, picture = item
        if picture is None:
            return time_s, None
        picture = rotate_image(picture, settings.rotate)
        if displacements is not None:
            picture = shift_back(picture, next(displacements))
        thumbnails.add(picture)
        return time_s, crop_and_resize(picture, settings, source=source)

    clock: list[float] = []
    times: list[float] = []
    frames: list[Picture] = []
    for time_s, frame in overlap_decoding(decode_frames(clip, settings), make_frame):
        clock.append(time_s)
        if frame is not None:
            times.append(time_s)
            frames.append(frame)
    if not frames:
        span = f"from {min(clock, default=0.0):.3f} s to {max(clock, default=0.0):.3f} s"
        cut = f"skip_s = {settings.skip_s} and end_s = {settings.end_s}"
        raise ValueError(
            f"{source}: no frame to keep; {len(clock)} were read, {span}, with {cut}. Check the cut, or the "
            "file if none was read"
        )
    n_same = count_duplicates_at_start(frames)
    if n_same:
        warnings.warn(f"{source}: the first {n_same} frames only repeat the next one; dropped", stacklevel=4)
    whole, kept_s = np.stack(frames[n_same:]), np.array(times[n_same:])
    footage = assess_video(whole, kept_s - clock[0], thumbnails, crop=settings.crop)
    for sentence in footage.warnings:
        warnings.warn(f"{source}: {sentence}", stacklevel=4)
    meta = {
        "source": clip.path.name,
        "frames": len(whole),
        "first_s": clock[0],
        "start_s": times[n_same],
        "duplicates": n_same,
        "picture_px": [thumbnails.height, thumbnails.width],
    }
    return _Film(whole, kept_s, footage.numbers, meta)


def _measure_path(clip: VideoClip, settings: FrameSettings) -> Float64[np.ndarray, "T 2"]:
    """Displacement of the background of each kept image, in a first pass over the clip."""
    pictures = (
        cv2.cvtColor(rotate_image(picture, settings.rotate), cv2.COLOR_BGR2GRAY)
        for _, picture in decode_frames(clip, settings)
        if picture is not None
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the second pass warns of what is missing
        return path_to_undo(pictures, source=str(clip.path))


def _with_common_size(clips: Sequence[VideoClip], settings: FrameSettings) -> FrameSettings:
    """The same settings, with a size that suits all clips."""
    if len(clips) == 1:
        return settings
    sizes = [read_frame_size(clip, dt_s=settings.dt_s, rotate=settings.rotate) for clip in clips]
    if len(set(sizes)) == 1:
        return settings
    named = zip(clips, sizes, strict=True)
    listed = ", ".join(f"{clip.path.name} {columns} x {rows}" for clip, (rows, columns) in named)
    if settings.crop is not None:
        effect = "recording.crop takes the same pixels from each, whatever they show there"
        warnings.warn(f"clips differ in size ({listed} px); {effect}", stacklevel=4)
        return settings
    aspects = [columns / rows for rows, columns in sizes]
    if max(aspects) / min(aspects) > 1.0 + SAME_SHAPE:
        raise ValueError(
            f"clips differ in shape ({listed} px), and resizing would distort some of them; give a "
            "recording.crop that lies within all, or keep clips of one shape in the folder"
        )
    size = settings.size or min(sizes)
    resized = f"all are resized to {size[1]} x {size[0]} px"
    warnings.warn(f"clips differ in size ({listed} px); {resized}", stacklevel=4)
    return replace(settings, size=size)


def _warn_of_spacings(clips: Sequence[VideoClip], films: Sequence[_Film]) -> None:
    spacing = [float(np.median(np.diff(film.time_s))) if len(film.time_s) > 1 else np.nan for film in films]
    if np.nanmax(spacing) > (1.0 + SAME_SHAPE) * np.nanmin(spacing):
        named = zip(clips, spacing, strict=True)
        listed = ", ".join(f"{clip.path.name} {1.0 / step:.3f}" for clip, step in named)
        effect = "their own times are kept, but whatever counts in frames treats them alike"
        warnings.warn(f"clips differ in frame rate ({listed} frames/s); {effect}", stacklevel=3)
