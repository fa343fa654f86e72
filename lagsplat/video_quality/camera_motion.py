"""Measure and undo the camera's motion, from the background of a video.

Pyramidal Lucas-Kanade tracks corners of the first image through all others. The background is the stillest
group of corners that move together and are spread over the image, so neither a small object nor one that
moves more than the camera is mistaken for it. A static border or caption would be.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8
from scipy.ndimage import uniform_filter1d

MOST_CORNERS = 200
WINDOW = 15  # pixels of the search window
LARGEST_RESIDUAL = 15.0  # largest mean absolute difference of a tracked corner [levels of 255]
ALIKE = 0.3  # corners of the background agree within this [pixel rms]...
ALIKE_SHARE = 0.15  # ...or to this share of their motion
FEWEST, SHARE = 6, 0.1  # the background has at least this many corners, and this share of all
SPREAD = 0.2  # its bounding box covers at least this share of the image


@dataclass(frozen=True)
class CameraMotion:
    """Displacement of the image since the first frame [pixel of the video]."""

    rms_px: float  # spread of the path about its mean
    max_px: float  # largest displacement
    drift_px: float  # largest displacement of the running mean over a tenth of the video
    jitter_px: float  # rms of the rest


def track_background(pictures: Iterable[UInt8[np.ndarray, "h w"]]) -> Float64[np.ndarray, "T 2"] | None:
    """Displacement (x, y) of the background since the first image [pixel], NaN where it is hidden.

    None if no background can be measured: too few corners agree, or all lie in one place.
    """
    following = iter(pictures)
    first = next(following)
    corners = _follow(first, following)
    background = None if corners is None else _stillest_group(corners, first.shape)
    if corners is None or background is None:
        return None
    moved = corners[:, background] - corners[:1, background]
    seen = np.isfinite(moved[..., 0]).sum(axis=1) >= min(FEWEST, int(background.sum()))
    path = np.full((len(moved), 2), np.nan)
    path[seen] = np.nanmedian(moved[seen], axis=1)
    return path


def measure_path(path: Float64[np.ndarray, "T 2"]) -> CameraMotion:
    """Statistics of a path [pixel]; images with a hidden background do not count."""
    path = path[np.isfinite(path[:, 0])]
    path = path - path[0]
    slow = uniform_filter1d(path, max(1, len(path) // 10), axis=0, mode="nearest")

    def rms(x: Float64[np.ndarray, "T 2"]) -> float:
        return float(np.sqrt((x**2).sum(axis=1).mean()))

    return CameraMotion(
        rms_px=rms(path - path.mean(axis=0)),
        max_px=float(np.hypot(*path.T).max()),
        drift_px=float(np.hypot(*(slow - slow[0]).T).max()),
        jitter_px=rms(path - slow),
    )


def _follow(
    first: UInt8[np.ndarray, "h w"], following: Iterable[UInt8[np.ndarray, "h w"]]
) -> Float64[np.ndarray, "T N 2"] | None:
    """Corners of the first image in all images, NaN where one is lost; None if there are too few."""
    start = cv2.goodFeaturesToTrack(first, MOST_CORNERS, 0.02, max(4, max(first.shape) // 30))
    if start is None or len(start) < FEWEST:
        return None
    corners, last = [start[:, 0].astype(np.float64)], start.copy()
    for picture in following:
        # Always tracked from the first image, so that errors do not accumulate.
        now, status, residual = cv2.calcOpticalFlowPyrLK(
            first,
            picture,
            start,
            last.copy(),
            winSize=(WINDOW, WINDOW),
            maxLevel=3,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.003),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        lost = (status[:, 0] == 0) | (residual[:, 0] > LARGEST_RESIDUAL)
        last = np.where(lost[:, None, None], last, now)
        corners.append(np.where(lost[:, None], np.nan, now[:, 0].astype(np.float64)))
    return np.stack(corners)


def _stillest_group(
    corners: Float64[np.ndarray, "T N 2"], shape: tuple[int, ...]
) -> Bool[np.ndarray, " N"] | None:
    moved = corners - corners[0]
    steady = np.isfinite(moved[..., 0]).mean(axis=0) > 0.5
    travel = np.full(len(steady), np.inf)
    if steady.any():
        travel[steady] = np.sqrt(np.nanmean((moved[:, steady] ** 2).sum(axis=-1), axis=0))
    for chosen in np.argsort(travel)[: int(steady.sum())]:
        apart = moved - moved[:, chosen : chosen + 1]
        common = np.isfinite(apart[..., 0])
        squares = np.where(common, (apart**2).sum(axis=-1), 0.0).sum(axis=0)
        rms = np.sqrt(squares / np.maximum(common.sum(axis=0), 1))
        alike = steady & (common.mean(axis=0) > 0.3) & (rms < max(ALIKE, ALIKE_SHARE * travel[chosen]))
        if alike.sum() < max(FEWEST, SHARE * steady.sum()):
            continue
        box = np.ptp(corners[0, alike], axis=0)
        if box[0] * box[1] >= SPREAD * shape[0] * shape[1]:
            return alike
    return None


def path_to_undo(pictures: Iterable[UInt8[np.ndarray, "h w"]], *, source: str) -> Float64[np.ndarray, "T 2"]:
    """Displacement (x, y) of the background in each grey image since the first [pixel].

    Raises:
        ValueError: the background cannot be measured, in all images or in one.
    """
    path = track_background(pictures)
    if path is None:
        raise ValueError(
            f"{source}: recording.stabilise needs a background that can be followed, but too few corners "
            "stand still or move alike; set it to false, or film with something textured behind the system"
        )
    hidden = np.flatnonzero(np.isnan(path[:, 0]))
    if hidden.size:
        raise ValueError(
            f"{source}: recording.stabilise cannot follow the background in {hidden.size} of {len(path)} "
            f"frames, the first of them frame {hidden[0]} of those kept; cut them off with recording.skip_s "
            "and end_s, or set it to false"
        )
    return path


def shift_back(
    picture: UInt8[np.ndarray, "h w 3"], moved: Float64[np.ndarray, " 2"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Shift ``picture`` back by its displacement (x, y) [pixel]; the border is replicated.

    Cubic interpolation; rotation and scale are not corrected.
    """
    back = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]]])
    return cv2.warpAffine(
        picture,
        back,
        (picture.shape[1], picture.shape[0]),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
