"""Exposure flicker: how the brightness of what stands still goes up and down."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64
from scipy.signal import periodogram

DARKEST, BRIGHTEST = 20.0, 245.0  # levels between which a camera answers in proportion


@dataclass(frozen=True)
class Flicker:
    """``rms_percent`` of the mean brightness, and the frequency [Hz] at which most of it happens."""

    rms_percent: float
    frequency_hz: float


def exposure_gain(grey: Float32[np.ndarray, "T h w"]) -> Float64[np.ndarray, " T"] | None:
    """Brightness of each frame against the median frame, on pixels that do not move; 1 is unchanged.

    Moving pixels are told apart after a first guess at the gain, so that flicker does not look like motion.
    None where hardly a pixel is neither black nor white.
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


def exposure_flicker(gain: Float64[np.ndarray, " T"], time_s: Float64[np.ndarray, " T"]) -> Flicker:
    """Spread and dominant frequency of `exposure_gain`."""
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    level = np.interp(even, time_s, gain)
    frequencies, power = periodogram(level, fs=1.0 / (even[1] - even[0]), window="hann", nfft=8 * len(even))
    return Flicker(
        rms_percent=float(100.0 * gain.std() / gain.mean()), frequency_hz=float(frequencies[np.argmax(power)])
    )
