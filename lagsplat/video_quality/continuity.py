"""Continuity of a video: exposure flicker, loops that repeat earlier frames, and cuts."""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.signal import periodogram

DARKEST, BRIGHTEST = 20.0, 245.0  # levels between which a camera responds linearly


@dataclass(frozen=True)
class ExposureFlicker:
    """``rms_percent`` of the mean brightness, and the frequency [Hz] at which most of it happens."""

    rms_percent: float
    frequency_hz: float


def measure_exposure_gain(grey: Float32[np.ndarray, "T h w"]) -> Float64[np.ndarray, " T"] | None:
    """Brightness of each frame relative to the median frame, on pixels that do not move; 1 is unchanged.

    Moving pixels are separated after a first estimate of the gain, so that flicker does not look like
    motion. None if nearly all pixels are black or white.
    """
    usual = np.median(grey[:: max(1, len(grey) // 100)], axis=0)
    usable = (usual > DARKEST) & (usual < BRIGHTEST)
    if usable.mean() < 0.02:
        return None
    values, usual = grey[:, usable], usual[usable]
    guess = np.median(values / usual, axis=1)
    spread = (values / guess[:, None] / usual).std(axis=0)
    still = spread <= np.median(spread)
    return values[:, still].mean(axis=1, dtype=np.float64) / usual[still].mean(dtype=np.float64)


def find_exposure_flicker(
    gain: Float64[np.ndarray, " T"], time_s: Float64[np.ndarray, " T"]
) -> ExposureFlicker:
    """Spread and dominant frequency of the gain from `measure_exposure_gain`."""
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    level = np.interp(even, time_s, gain)
    frequencies, power = periodogram(level, fs=1.0 / (even[1] - even[0]), window="hann", nfft=8 * len(even))
    return ExposureFlicker(
        rms_percent=float(100.0 * gain.std() / gain.mean()), frequency_hz=float(frequencies[np.argmax(power)])
    )


SIDE = 24  # pixels: enough to distinguish two instants of a motion
CLOSE = 0.25  # frames are equal if they differ by less than this share of the median step between frames
MOVING = 0.5  # a stretch counts if it moves at least by this share of the median step
LEAST_S, LEAST_FRAMES = 0.5, 12
MOST_FRAMES = 4000  # limit, because all pairs are compared


@dataclass(frozen=True)
class LoopRepeat:
    """Frames from ``start_s`` to ``stop_s`` repeat those from ``original_s`` on."""

    start_s: float
    stop_s: float
    original_s: float


def find_loop(grey: Float32[np.ndarray, "T h w"], time_s: Float64[np.ndarray, " T"]) -> LoopRepeat | None:
    """The longest stretch that repeats an earlier one to well within a step of the motion, or None.

    A strictly periodic motion, in whole frames and without noise, also counts as a repetition. Videos of
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
    return LoopRepeat(float(time_s[start + lag]), float(time_s[stop - 1 + lag]), float(time_s[start]))


def _longest_run(true: Bool[np.ndarray, " n"]) -> tuple[int, int]:
    """Start and stop of the longest stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    if not len(edges):
        return 0, 0
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * longest]), int(edges[2 * longest + 1])


RATIO = 5.0  # a cut changes the image this many times as much as the frames around it...
SHARE = 0.25  # ...and at least this share of the change between two frames taken anywhere
AROUND = 2  # frames on either side
SLIGHT = 0.02  # share of that change below which a video is static
NOISES, LEVELS = 5.0, 2.0  # medians of the change, and levels of 255, that noise may change a pixel by


@dataclass(frozen=True)
class SceneCut:
    """A jump between two frames: time of the later frame [s], and ratio to the change around it."""

    time_s: float
    ratio: float


def find_scene_cuts(
    grey: Float32[np.ndarray, "T h w"], time_s: Float64[np.ndarray, " T"]
) -> tuple[SceneCut, ...]:
    """Jumps that the motion does not explain; ``grey`` should be free of flicker.

    A single bright or broken frame is no cut: the video goes on as before. A small object that jumps while
    it moves by a third of its own size per frame hardly changes more pixels than before, and is missed.
    """
    half = len(grey) // 2
    usual_change = np.median([np.median(np.abs(later - earlier)) for earlier, later in pairwise(grey)])
    limit = NOISES * float(usual_change) + LEVELS
    change = np.array([_excess(later - earlier, limit) for earlier, later in pairwise(grey)])
    anywhere = float(np.median([_excess(grey[i + half] - grey[i], limit) for i in range(half)]))
    found = []
    for i, now in enumerate(change):
        around = np.concatenate([change[max(0, i - AROUND) : i], change[i + 1 : i + 1 + AROUND]])
        usual = max(float(around.max()), SLIGHT * anywhere, 1e-6)
        if now > RATIO * usual and now > SHARE * anywhere:
            found.append(SceneCut(time_s=float(time_s[i + 1]), ratio=float(now / usual)))
    return tuple(found)


def _excess(difference: Float32[np.ndarray, "h w"], limit: float) -> float:
    """Mean change beyond ``limit``, the change that noise and compression cause in a static image."""
    return float(np.maximum(np.abs(difference) - limit, 0.0).mean(dtype=np.float64))
