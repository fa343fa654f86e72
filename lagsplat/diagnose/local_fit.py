"""Value, rate and acceleration at a sample, by a polynomial through the samples around it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.io.motion import Motion

CHUNK = 4096


@dataclass(frozen=True)
class LocalFit:
    """Smoothed coordinates, their rates [1/s] and accelerations [1/s^2] at every sample.

    ``rate_gain`` is the standard deviation of a rate per standard deviation of white noise [1/s].
    """

    q: Float64[np.ndarray, "T d"]
    v: Float64[np.ndarray, "T d"]
    a: Float64[np.ndarray, "T d"]
    rate_gain: Float64[np.ndarray, " T"]


def fit_locally(motion: Motion, *, half_width: int) -> LocalFit:
    """A cubic through the ``2 half_width + 1`` samples nearest to each, never across the border of a clip.

    Times may be uneven. Near its border a clip's window is one-sided; a clip of fewer samples than a window
    is fitted as a whole, by a polynomial of as high a degree as it can bear, at most three.

    Raises:
        ValueError: a half width below 2.

    Source: local polynomial regression, Fan and Gijbels 1996, chapter 3.
    """
    if half_width < 2:
        raise ValueError(f"half_width is {half_width}; a cubic with a sample to spare needs at least 2")
    parts = [np.zeros((3, motion.n, motion.d)), np.zeros(motion.n)]
    for start, stop in motion.segments:
        width = min(2 * half_width + 1, stop - start)
        for first in range(start, stop, CHUNK):
            at = np.arange(first, min(first + CHUNK, stop))
            left = np.clip(at - half_width, start, stop - width)
            weights = _weights(motion.time_s, at, left[:, None] + np.arange(width))
            around = motion.q[left[:, None] + np.arange(width)]
            parts[0][:, at] = np.einsum("nck,nkd->cnd", weights, around)
            parts[1][at] = np.linalg.norm(weights[:, 1], axis=1)
    (q, v, a), gain = parts
    return LocalFit(q, v, a, gain)


def _weights(time_s: np.ndarray, at: np.ndarray, window: np.ndarray) -> Float64[np.ndarray, "N 3 K"]:
    """Rows that turn the samples of a window into value, rate and acceleration at sample ``at``."""
    degree = min(3, window.shape[1] - 1)
    offset = time_s[window] - time_s[at][:, None]
    scale = np.abs(offset).max(axis=1, keepdims=True)
    scale[scale == 0.0] = 1.0  # a clip of one sample: it has a value and nothing else
    powers = (offset / scale)[..., None] ** np.arange(degree + 1)
    normal = np.einsum("nki,nkj->nij", powers, powers)
    solved = np.linalg.solve(normal, powers.transpose(0, 2, 1))
    weights = np.zeros((len(at), 3, window.shape[1]))
    factor = np.array([1.0, 1.0, 2.0]) / scale ** np.arange(3)
    kept = min(3, degree + 1)
    weights[:, :kept] = solved[:, :kept] * factor[:, :kept, None]
    return weights
