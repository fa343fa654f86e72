"""Recordings from a film, by OpenCV.

Times are the container's presentation timestamps, read for every frame. The frame rate and frame count in a
file's header are averages at best and often wrong, so neither is used. The picture is turned as the file's
rotation tag says, which is OpenCV's default; crops are given in the turned picture.
"""

import os
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.io.checksum import sha256_of
from lagsplat.io.container import missing_bytes
from lagsplat.io.recording import Recording


def read_video(
    path: str | os.PathLike[str],
    *,
    crop: Sequence[int] | None,
    skip_s: float,
    size: tuple[int, int] | None,
    end_s: float | None = None,
    licence: str = "unknown",
) -> Recording:
    """The film at ``path`` as one clip without inputs.

    ``crop`` is (x, y, width, height) [pixel of the film]. Frames from ``skip_s`` up to ``end_s`` (exclusive)
    seconds after the first frame are kept; their times stay those of the container. ``size`` is (height,
    width) after averaging over areas; None keeps the cropped size. A film that is cut short gives the frames
    that are whole, with a warning.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: the file cannot be decoded, holds no frame in the range, goes backwards in time, or is
        smaller
            than the crop.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check recording.path")
    times, frames = [], []
    first_s = last_s = 0.0
    n_read = 0
    for time_s, picture in _decode(path, skip_s=skip_s, end_s=end_s):
        first_s = time_s if n_read == 0 else first_s
        last_s = time_s
        n_read += 1
        if picture is not None:
            times.append(time_s)
            frames.append(_shape(path, picture, crop=crop, size=size))
    if not frames:
        raise ValueError(
            f"{path}: no frame to keep; {n_read} were read, from {first_s:.3f} s to {last_s:.3f} s, with "
            f"skip_s = {skip_s} and end_s = {end_s}. Check the cut, or the file if none was read"
        )
    return Recording(
        frames=np.stack(frames),
        time_s=np.array(times),
        inputs=np.zeros((len(frames), 0)),
        input_names=(),
        input_units=(),
        meta={
            "origin": "filmed",
            "source": path.name,
            "sha256": sha256_of(path),
            "licence": licence,
            "crop": None if crop is None else list(crop),
            "skip_s": skip_s,
            "end_s": end_s,
        },
    )


def _decode(
    path: Path, *, skip_s: float, end_s: float | None
) -> Iterator[tuple[float, UInt8[np.ndarray, "H W 3"] | None]]:
    """Time [s] and picture (BGR) of each frame up to ``end_s``; None in place of pictures before
    ``skip_s``."""
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened():
            raise ValueError(f"{path}: OpenCV cannot open it; it is truncated or not a film. Fetch it again")
        times: list[float] = []
        while capture.grab():
            # The position is that of the frame just grabbed; the header's frame rate does not enter.
            time_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            if times and not time_s > times[-1]:
                raise ValueError(
                    f"{path}: frame {len(times)} is at {time_s:.6f} s, not after frame {len(times) - 1} at "
                    f"{times[-1]:.6f} s; times must strictly increase. Remux the film, or cut it with end_s"
                )
            times.append(time_s)
            if end_s is not None and time_s - times[0] >= end_s:
                return
            if time_s - times[0] < skip_s:
                yield time_s, None
                continue
            whole, picture = capture.retrieve()
            if not whole:
                times.pop()
                break
            yield time_s, picture
        if not times:
            return
        announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        _warn_if_short(path, n_read=len(times), announced=announced, last_s=times[-1])
    finally:
        capture.release()


def _warn_if_short(path: Path, *, n_read: int, announced: int, last_s: float) -> None:
    lacking = missing_bytes(path)
    if lacking is None and n_read < announced:
        reason = f"its header announces {announced}"
    elif lacking:
        reason = f"{lacking} bytes are missing at the end of the file"
    else:
        return
    warnings.warn(f"{path}: only {n_read} frames are whole, up to {last_s:.3f} s; {reason}", stacklevel=4)


def _shape(
    path: Path,
    picture: UInt8[np.ndarray, "h w 3"],
    *,
    crop: Sequence[int] | None,
    size: tuple[int, int] | None,
) -> UInt8[np.ndarray, "H W 3"]:
    rows, columns = picture.shape[:2]
    x, y, width, height = crop if crop is not None else (0, 0, columns, rows)
    if min(x, y) < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
        raise ValueError(
            f"{path}: crop {[x, y, width, height]} (x, y, width, height) reaches outside the picture, "
            f"which is {columns} wide and {rows} high; make it smaller"
        )
    picture = picture[y : y + height, x : x + width]
    if size is not None:
        picture = cv2.resize(picture, (size[1], size[0]), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
