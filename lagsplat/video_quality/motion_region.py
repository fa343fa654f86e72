"""Where a video moves: how much each pixel changes beyond its noise, and the box that holds these changes."""

import numpy as np
from jaxtyping import Float, Float32
from scipy.special import ndtri

FALSE_PIXELS = 1e-3  # pixels of pure noise that are expected to count, in a whole video
LEAST_LEVELS = 1.0  # of 255: a pixel that changes by less shows no motion that is more than rounding
OUTSIDE = 0.0025  # share of the changes' energy that may lie beyond each side of the box
MARGIN = 0.1  # by which the box is widened on each side, over its own side


def measure_motion(grey: Float32[np.ndarray, "T h w"]) -> Float[np.ndarray, "h w"]:
    """Standard deviation of each pixel over time [level], without its noise; zero where chance explains it.

    What differs from frame to frame is taken for noise: half the mean squared successive difference, which
    over the variance is 1 for white noise, with a standard deviation of one over the root of the frames. A
    motion of eight frames a period or more keeps seven tenths of its variance. Less than a level counts as
    none.

    Source: von Neumann, Kent, Bellinson, Hart 1941, doi:10.1214/aoms/1177731746.
    """
    if len(grey) < 2:
        return np.zeros(grey.shape[1:])
    noise = 0.5 * np.mean(np.diff(grey, axis=0) ** 2, axis=0)
    variance = grey.var(axis=0)
    chance = -ndtri(FALSE_PIXELS / noise.size) / np.sqrt(len(grey))
    motion = np.sqrt(np.maximum(variance - noise, 0.0))
    return np.where((motion >= LEAST_LEVELS) & (variance - noise > chance * variance), motion, 0.0)


def find_motion_box(motion: Float[np.ndarray, "h w"]) -> tuple[int, int, int, int] | None:
    """Box (x, y, width, height) [pixel] with a margin around what moves; None where nothing does."""
    energy = motion**2
    if not energy.any():
        return None
    sides = []
    for along in (energy.sum(axis=0), energy.sum(axis=1)):
        share = np.cumsum(along) / along.sum()
        first, last = np.searchsorted(share, [OUTSIDE, 1.0 - OUTSIDE])
        margin = int(np.ceil(MARGIN * (last - first + 1)))
        sides.append((max(int(first) - margin, 0), min(int(last) + margin + 1, len(along))))
    (left, right), (top, bottom) = sides
    return left, top, right - left, bottom - top
