"""Decode the images of one clip, each with its time, and detect truncated files and repeated first frames.

Times of a video are the container's presentation timestamps, read for every frame: the header's frame rate
and frame count are averages at best and often wrong. AVI has no timestamps; its frames are at multiples of
the stream's time base. Videos follow their rotation tag and images their EXIF tag, OpenCV's default. Frame
counts do not reveal truncation, because an edit list may hide frames of a complete file; box sizes do.
"""

import csv
import os
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.io.video.clips import VideoClip
from lagsplat.video_quality.frames import FrameSettings, rotate_image

BOX_HEADER, LONG_BOX_HEADER = 8, 16  # bytes


def count_missing_bytes(path: str | os.PathLike[str]) -> int | None:
    """Number of bytes the file lacks by its own box sizes; None if its format has none.

    Supports MP4 and QuickTime (ISO/IEC 14496-12, section 4.2) and AVI (RIFF, its outermost chunks).
    """
    total = os.path.getsize(path)
    with open(path, "rb") as file:
        first = file.read(BOX_HEADER)
        little_endian = first[:4] == b"RIFF"
        if not little_endian and first[4:] != b"ftyp":
            return None
        position = 0
        while position < total:
            file.seek(position)
            header = file.read(LONG_BOX_HEADER)
            if len(header) < BOX_HEADER:
                return BOX_HEADER - len(header)
            if little_endian:
                size = int.from_bytes(header[4:8], "little")
                position += BOX_HEADER + size + size % 2
                continue
            size = int.from_bytes(header[:4], "big")
            if size == 1:
                size = int.from_bytes(header[8:16], "big")
            if size == 0:  # "to the end of the file"
                return 0
            # A box smaller than its header is damaged; without this floor the loop would not advance.
            position += max(size, BOX_HEADER)
    return position - total


Pictures = Iterator[tuple[float, UInt8[np.ndarray, "H W 3"] | None]]


def decode_frames(clip: VideoClip, settings: FrameSettings) -> Pictures:
    """Yield time [s] and image (BGR) of each frame before ``end_s``; None for images before ``skip_s``.

    A truncated video gives its complete frames, with a warning.

    Raises:
        ValueError: a file cannot be decoded, times do not strictly increase or are unknown, or the images of
            a folder differ in size.
    """
    return _images(clip, settings) if clip.images else _film(clip.path, settings)


def read_first_image(clip: VideoClip, *, dt_s: float | None, rotate: int = 0) -> UInt8[np.ndarray, "H W 3"]:
    """The first image of a clip in RGB, rotated as its tag says and then clockwise by ``rotate`` [degree].

    Raises:
        ValueError: as `decode_frames`; or there is no image.
    """
    with closing(decode_frames(clip, FrameSettings(dt_s=dt_s))) as pictures:  # type: ignore[type-var]
        _, picture = next(pictures, (0.0, None))
    if picture is None:
        raise ValueError(f"{clip.path}: no frame to keep; 0 were read. Check the file")
    return cv2.cvtColor(rotate_image(picture, rotate), cv2.COLOR_BGR2RGB)


def read_frame_size(clip: VideoClip, *, dt_s: float | None, rotate: int = 0) -> tuple[int, int]:
    """Rows and columns of a clip's first image; arguments and errors as of `read_first_image`."""
    rows, columns = read_first_image(clip, dt_s=dt_s, rotate=rotate).shape[:2]
    return rows, columns


def _film(path: Path, settings: FrameSettings) -> Pictures:
    if settings.dt_s is not None:
        raise ValueError(
            f"{path}: recording.dt_s is {settings.dt_s}, but a film's own timestamps are used; unset it"
        )
    capture = cv2.VideoCapture(str(path))
    try:
        lacking = count_missing_bytes(path)
        if not capture.isOpened():
            why = f": {lacking} bytes and with them its index are missing at its end" if lacking else ""
            raise ValueError(
                f"{path}: OpenCV cannot open it; it is truncated or not a film, or its codec is unknown"
                f"{why}. Fetch it again, or re-encode it (ffmpeg -i FILE -c:v libx264 -crf 12 NEW.mp4)"
            )
        times: list[float] = []
        # The last frame of a truncated file may be incomplete, and no decoder reports it: a frame of such a
        # file waits until the next one is there.
        waiting: tuple[float, UInt8[np.ndarray, "H W 3"]] | None = None
        while capture.grab():
            # The position is that of the frame just grabbed, independent of the header's frame rate.
            time_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            if times and not time_s > times[-1]:
                raise ValueError(
                    f"{path}: frame {len(times)} is at {time_s:.6f} s, not after frame {len(times) - 1} at "
                    f"{times[-1]:.6f} s; times must strictly increase. Remux the film, or cut it with end_s"
                )
            times.append(time_s)
            if waiting is not None:
                yield waiting
                waiting = None
            if settings.end_s is not None and time_s - times[0] >= settings.end_s:
                return
            if time_s - times[0] < settings.skip_s:
                yield time_s, None
                continue
            whole, picture = capture.retrieve()
            if not whole:
                times.pop()
                break
            if lacking:
                waiting = time_s, picture
            else:
                yield time_s, picture
        if waiting is not None:
            times.pop()
        if times:
            announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
            _warn_if_short(path, times, lacking=lacking, announced=announced)
    finally:
        capture.release()


def _warn_if_short(path: Path, times: Sequence[float], *, lacking: int | None, announced: int) -> None:
    if lacking:
        reason = f"{lacking} bytes are missing at its end, and the frame before the break is left out"
    elif lacking is None and len(times) < announced:
        reason = f"its header announces {announced}"
    else:
        return
    problem = f"only {len(times)} frames are whole, up to {times[-1]:.3f} s"
    warnings.warn(f"{path}: {problem}; {reason}", stacklevel=4)


def _images(clip: VideoClip, settings: FrameSettings) -> Pictures:
    times = _times_of(clip, settings.dt_s)
    shape: tuple[int, ...] | None = None
    for time_s, path in zip(times, clip.images, strict=True):
        if settings.end_s is not None and time_s - times[0] >= settings.end_s:
            return
        if time_s - times[0] < settings.skip_s:
            yield time_s, None
            continue
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if picture is None:
            raise ValueError(f"{path}: OpenCV cannot read this image; it is damaged. Export it again")
        shape = picture.shape if shape is None else shape
        if picture.shape != shape:
            sizes = [f"{columns} x {rows}" for rows, columns in (picture.shape[:2], shape[:2])]
            raise ValueError(
                f"{path}: {sizes[0]} px, but the images before it are {sizes[1]}; make them equal"
            )
        yield time_s, picture


def _times_of(clip: VideoClip, dt_s: float | None) -> list[float]:
    """Time [s] of each image: from the table beside them, or every ``dt_s`` from 0."""
    n = len(clip.images)
    if clip.times is None:
        if dt_s is None:
            raise ValueError(
                f"{clip.path}: {n} images carry no times; give their spacing with recording.dt_s=SECONDS, "
                "or a times.csv beside them with a column t [s]"
            )
        return [dt_s * i for i in range(n)]
    if dt_s is not None:
        raise ValueError(f"{clip.times}: gives the times, and so does recording.dt_s = {dt_s}; drop one")
    with clip.times.open(newline="", encoding="utf-8-sig") as file:
        rows = list(csv.DictReader(file))
    try:
        times = [float(row["t"]) for row in rows]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{clip.times}: {error}; give one number a row in a column t [s]") from error
    if len(times) != n or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
        raise ValueError(
            f"{clip.times}: {len(times)} times for {n} images; give one finite time an image, in the order "
            "of their names, each above the one before"
        )
    return times


LOOKED_AT = 6  # frames
SHARE = 1 / 50  # of the median difference, below which two frames are equal


def count_duplicates_at_start(frames: Sequence[UInt8[np.ndarray, "H W 3"]]) -> int:
    """Number of leading frames that only repeat the next, as some recorders write.

    Two neighbours are equal if their mean squared difference is below a fiftieth of the median over the
    first six frames.
    """
    first = [np.asarray(frame, dtype=np.float32) for frame in frames[:LOOKED_AT]]
    apart = [float(((b - a) ** 2).mean()) for a, b in pairwise(first)]
    new = [difference >= SHARE * float(np.median(apart)) for difference in apart]
    return new.index(True) if True in new else 0


Item = TypeVar("Item")
Result = TypeVar("Result")
AHEAD = 4  # items that may wait; more would only use memory


def overlap_decoding(items: Iterable[Item], work: Callable[[Item], Result]) -> Iterator[Result]:
    """Apply ``work`` to each item, in order, in one other thread while this one makes the next item.

    Faster if both release Python's lock, as OpenCV does. Errors of either are raised here.
    """
    with ThreadPoolExecutor(max_workers=1) as worker:
        pending: deque[Future[Result]] = deque()
        for item in items:
            pending.append(worker.submit(work, item))
            if len(pending) > AHEAD:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
