"""How many frames a film has for each period of the motion in it."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64

SIDE = 32
MOST_FRAMES = 1200  # of one stretch: all pairs of them are multiplied
COMPONENTS = 5
BAND = 0.12  # a line and its side lobes: this share of its frequency to either side
LEAST_SHARE = 0.01  # of the variance that a band must hold to be a motion
CONTRAST = 3.0  # times as dense as the bands on either side
SUBHARMONIC = 0.25  # share of a band's power that makes its half or third the fundamental
PADDING = 8


@dataclass(frozen=True)
class Sampling:
    """Dominant period [s] of the motion, and frames to a period."""

    period_s: float
    samples: float


def samples_per_period(
    grey: Float32[np.ndarray, "T h w"], time_s: Float64[np.ndarray, " T"]
) -> Sampling | None:
    """The period at which the leading principal components of the frames have most kinetic energy.

    Energy is power times squared frequency: a slow push may be large and still not be the motion. A small
    object that crosses many pixels has overtones, so a half or a third of the frequency is preferred where
    it has power; near the Nyquist limit such overtones fold back and can hide the period. None where nothing
    stands out of the noise.
    """
    grey, time_s = grey[:MOST_FRAMES], time_s[:MOST_FRAMES]
    small = np.stack([cv2.resize(frame, (SIDE, SIDE), interpolation=cv2.INTER_AREA) for frame in grey])
    flat = small.reshape(len(small), -1).astype(np.float64)
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
    return Sampling(period_s=1.0 / centre, samples=1.0 / (centre * spacing_s))


def _strongest_band(
    frequency: Float64[np.ndarray, " F"], power: Float64[np.ndarray, " F"], slowest: float
) -> float | None:
    """Centre of the band of most kinetic energy among those that stand out, or its subharmonic."""

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
        below = [
            part
            for part in (best / 2, best / 3)
            if part > slowest and content(part, power) > SUBHARMONIC * content(best, power)
        ]
        if not below:
            break
        best = max(below, key=lambda part: content(part, power))
    return best
