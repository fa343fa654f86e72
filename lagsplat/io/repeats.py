"""Stretches of a film that were shown before: nothing new to learn from, or to be tested on."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

SIDE = 24  # pixels: enough to tell two moments of a motion apart
CLOSE = 0.25  # frames are the same if they differ by less than this share of a usual step from frame to frame
MOVING = 0.5  # a stretch counts if it moves at least by this share of a usual step
LEAST_S, LEAST_FRAMES = 0.5, 12
MOST_FRAMES = 4000  # all pairs are compared


@dataclass(frozen=True)
class Repeat:
    """Frames from ``start_s`` to ``stop_s`` are those from ``original_s`` on, again."""

    start_s: float
    stop_s: float
    original_s: float


def find_repeat(grey: Float32[np.ndarray, "T h w"], time_s: Float64[np.ndarray, " T"]) -> Repeat | None:
    """The longest stretch that repeats an earlier one to well within a step of the motion, or None.

    A motion that is strictly periodic, in whole frames and without noise, repeats itself as well. Films of
    more than 4000 frames are not searched.
    """
    if not 2 * LEAST_FRAMES < len(grey) <= MOST_FRAMES:
        return None
    small = np.stack([cv2.resize(frame, (SIDE, SIDE), interpolation=cv2.INTER_AREA) for frame in grey])
    flat = small.reshape(len(small), -1) - small.reshape(len(small), -1).mean(axis=0)
    step = np.linalg.norm(np.diff(flat, axis=0), axis=1)
    usual = float(np.median(step))
    if usual == 0.0:
        return None
    power = (flat**2).sum(axis=1)
    apart = np.sqrt(np.maximum(power[:, None] + power[None] - 2.0 * flat @ flat.T, 0.0))
    least = max(LEAST_FRAMES, round(LEAST_S / float(np.median(np.diff(time_s)))))
    best, found = least - 1, None
    for lag in range(least, len(grey) - least):
        start, stop = _longest_run(np.diagonal(apart, lag) < CLOSE * usual)
        if stop - start > best and np.median(step[start : stop - 1]) > MOVING * usual:
            best, found = stop - start, (start, stop, lag)
    if found is None:
        return None
    start, stop, lag = found
    return Repeat(float(time_s[start + lag]), float(time_s[stop - 1 + lag]), float(time_s[start]))


def _longest_run(true: Bool[np.ndarray, " n"]) -> tuple[int, int]:
    """Start and stop of the longest stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    if not len(edges):
        return 0, 0
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * longest]), int(edges[2 * longest + 1])
