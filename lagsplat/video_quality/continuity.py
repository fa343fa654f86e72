"""A video in time: exposure flicker, loops that repeat earlier frames, cuts, frames per period."""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.signal import periodogram

Grey = Float32[np.ndarray, "T h w"]  # frames in grey, 0 to 255
Times = Float64[np.ndarray, " T"]

DARKEST, BRIGHTEST = 20.0, 245.0  # levels between which a camera responds linearly


@dataclass(frozen=True)
class ExposureFlicker:
    """``rms_percent`` of the mean brightness, and the frequency [Hz] at which most of it happens."""

    rms_percent: float
    frequency_hz: float


def measure_exposure_gain(grey: Grey) -> Float64[np.ndarray, " T"] | None:
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


def find_exposure_flicker(gain: Float64[np.ndarray, " T"], time_s: Times) -> ExposureFlicker:
    """Spread and dominant frequency of the gain from `measure_exposure_gain`."""
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    level, rate_hz = np.interp(even, time_s, gain), 1.0 / (even[1] - even[0])
    frequencies, power = periodogram(level, fs=rate_hz, window="hann", nfft=8 * len(even))
    return ExposureFlicker(float(100.0 * gain.std() / gain.mean()), float(frequencies[np.argmax(power)]))


LOOP_SIDE = 24  # pixels: enough to distinguish two instants of a motion
CLOSE = 0.25  # frames are equal if they differ by less than this share of the median step between frames
MOVING = 0.5  # a stretch counts if it moves at least by this share of the median step
LEAST_S, LEAST_FRAMES = 0.5, 12
MOST_LOOP_FRAMES = 4000  # limit, because all pairs are compared


@dataclass(frozen=True)
class LoopRepeat:
    """Frames from ``start_s`` to ``stop_s`` repeat those from ``original_s`` on."""

    start_s: float
    stop_s: float
    original_s: float


def find_loop(grey: Grey, time_s: Times) -> LoopRepeat | None:
    """The longest stretch that repeats an earlier one to well within a step of the motion, or None.

    A strictly periodic motion, in whole frames and without noise, also counts as a repetition. Videos of
    more than 4000 frames are not searched.
    """
    if not 2 * LEAST_FRAMES < len(grey) <= MOST_LOOP_FRAMES:
        return None
    small = _shrink(grey, LOOP_SIDE)
    flat = small - small.mean(axis=0)
    step = np.linalg.norm(np.diff(flat, axis=0), axis=1)
    usual = float(np.median(step))
    if usual == 0.0:
        return None
    power = (flat**2).sum(axis=1)
    apart = np.sqrt(np.maximum(power[:, None] + power[None] - 2.0 * flat @ flat.T, 0.0))
    least = max(LEAST_FRAMES, round(LEAST_S / float(np.median(np.diff(time_s)))))
    longest, repeat = least - 1, None
    for lag in range(least, len(grey) - least):
        start, stop = _longest_run(np.diagonal(apart, lag) < CLOSE * usual)
        if stop - start > longest and np.median(step[start : stop - 1]) > MOVING * usual:
            longest = stop - start
            repeat = LoopRepeat(
                float(time_s[start + lag]), float(time_s[stop - 1 + lag]), float(time_s[start])
            )
    return repeat


def _shrink(grey: Grey, side: int) -> Float32[np.ndarray, "T n"]:
    """The pixels of each frame after averaging it to ``side`` x ``side``."""
    return np.stack([cv2.resize(f, (side, side), interpolation=cv2.INTER_AREA).ravel() for f in grey])


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


def find_scene_cuts(grey: Grey, time_s: Times) -> tuple[SceneCut, ...]:
    """Jumps that the motion does not explain; ``grey`` should be free of flicker.

    A single bright or broken frame is no cut: the video goes on as before. A small object that jumps while
    it moves by a third of its own size per frame hardly changes more pixels than before, and is missed.
    """
    half = len(grey) // 2
    usual_change = np.median([np.median(np.abs(later - earlier)) for earlier, later in pairwise(grey)])
    limit = NOISES * float(usual_change) + LEVELS
    change = np.array([_excess(later - earlier, limit) for earlier, later in pairwise(grey)])
    anywhere = float(np.median([_excess(grey[i + half] - grey[i], limit) for i in range(half)]))
    cuts = []
    for i, now in enumerate(change):
        around = np.concatenate([change[max(0, i - AROUND) : i], change[i + 1 : i + 1 + AROUND]])
        usual = max(float(around.max()), SLIGHT * anywhere, 1e-6)
        if now > RATIO * usual and now > SHARE * anywhere:
            cuts.append(SceneCut(time_s=float(time_s[i + 1]), ratio=float(now / usual)))
    return tuple(cuts)


def _excess(difference: Float32[np.ndarray, "h w"], limit: float) -> float:
    """Mean change beyond ``limit``, the change that noise and compression cause in a static image."""
    return float(np.maximum(np.abs(difference) - limit, 0.0).mean(dtype=np.float64))


SIDE = 32  # pixels
MOST_FRAMES = 1200  # of a stretch: all pairs are multiplied
COMPONENTS = 5
BAND = 0.12  # half width of a spectral line with side lobes, as a share of its frequency
LEAST_SHARE = 0.01  # share of the variance that a band must contain to be a motion
CONTRAST = 3.0  # ratio to the density of the bands on either side
SUBHARMONIC = 0.25  # share of a band's power that makes its half or third the fundamental
PADDING = 8


@dataclass(frozen=True)
class SamplingRate:
    """Dominant period [s] of the motion, and frames per period."""

    period_s: float
    samples: float


def measure_samples_per_period(grey: Grey, time_s: Times) -> SamplingRate | None:
    """The period at which the leading principal components of the frames have most kinetic energy.

    Energy is power times squared frequency: a slow push may be large and still not be the motion. A small
    object that crosses many pixels has overtones, so half or a third of the frequency is preferred if it has
    power; near the Nyquist limit such overtones alias and can hide the period. None if no band stands out of
    the noise.
    """
    grey, time_s = grey[:MOST_FRAMES], time_s[:MOST_FRAMES]
    flat = _shrink(grey, SIDE).astype(np.float64)
    flat -= flat.mean(axis=0)
    values, vectors = np.linalg.eigh(flat @ flat.T)
    if values[-1] <= 1e-9:
        return None
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    spacing_s = float(even[1] - even[0])
    power = np.zeros(PADDING * len(even) // 2 + 1)
    for value, vector in zip(values[-COMPONENTS:], vectors.T[-COMPONENTS:], strict=True):
        component = np.interp(even, time_s, vector)
        spectrum = np.fft.rfft((component - component.mean()) * np.hanning(len(even)), PADDING * len(even))
        power += max(float(value), 0.0) * np.abs(spectrum) ** 2
    frequency = np.fft.rfftfreq(PADDING * len(even), spacing_s)
    slowest = 1.5 / (even[-1] - even[0])
    power[frequency < slowest] = 0.0
    band = _strongest_band(frequency, power, slowest)
    if band is None:
        return None
    near = (frequency > (1 - BAND) * band) & (frequency < (1 + BAND) * band)
    centre = float(frequency[near][np.argmax(power[near])])
    return SamplingRate(period_s=1.0 / centre, samples=1.0 / (centre * spacing_s))


def _strongest_band(
    frequency: Float64[np.ndarray, " F"], power: Float64[np.ndarray, " F"], slowest: float
) -> float | None:
    """Centre of the band with most kinetic energy among those that stand out, or its subharmonic."""

    def density(low: float, high: float) -> float:
        inside = (frequency > low) & (frequency < high)
        return float(power[inside].mean()) if inside.any() else 0.0

    def content(centre: float, weight: Float64[np.ndarray, " F"]) -> float:
        return float(weight[(frequency > (1 - BAND) * centre) & (frequency < (1 + BAND) * centre)].sum())

    best, most = None, 0.0
    for centre in np.geomspace(slowest, frequency[-1], 150):
        flanks = max(density(0.6 * centre, 0.8 * centre), density(1.25 * centre, 1.6 * centre))
        stands_out = density((1 - BAND) * centre, (1 + BAND) * centre) > CONTRAST * flanks
        kinetic = content(centre, power * frequency**2)
        if stands_out and kinetic > most and content(centre, power) > LEAST_SHARE * power.sum():
            best, most = float(centre), kinetic
    while best is not None:
        parts = [part for part in (best / 2, best / 3) if part > slowest]
        below = [part for part in parts if content(part, power) > SUBHARMONIC * content(best, power)]
        if not below:
            break
        best = max(below, key=lambda part: content(part, power))
    return best
