"""What the forward and backward kernels share: the tile they work on, and how a Gaussian crosses it.

A tile is a flat float32 array. Row by row it holds ``planes`` strips of ``PITCH`` values: transmittance, the index
of the Gaussian that finished each pixel, and whatever the kernel adds. The strips of a row lie side by side because
strips a multiple of 4 KiB apart would delay each other's loads. Behind the ``COLUMNS`` pixels of a row come ``WIDTH``
more that are finished from the start, so that a run of ``WIDTH`` pixels may begin anywhere.

Along row ``y`` a Gaussian is a one-dimensional one. With ``dy = y - m_y`` and the blurred covariance ``S``,

    sigma = dy^2 / (2 S_yy) + (x - m_x - slope dy)^2 / (2 v),    slope = S_xy / S_yy,    v = S_xx - S_xy^2 / S_yy.

That costs one square per pixel, tells exactly where ``sigma <= ln(255 o)``, and loses no digits for thin Gaussians,
where the inverse covariance would.
"""

import math

import numpy as np
from numba import njit, prange

from lagsplat.splat.lanes import WIDTH

ROWS = 32
COLUMNS = 32
PITCH = COLUMNS + WIDTH
STOP = PITCH
JIT = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}}

# Columns of a spot: what a Gaussian is in one frame.
X, Y, OPACITY, CUTOFF, HALF_WIDTH, HALF_HEIGHT = range(6)
# Columns of a slice: what all frames share, see the module's docstring.
SLOPE, PRECISION_X, PRECISION_Y, EXTENT_X, EXTENT_Y = range(5)

ZERO = np.float32(0.0)
ONE = np.float32(1.0)
HALF = np.float32(0.5)
# Pixels on the rim are found by a square root; whether they count is decided by sigma alone.
RIM = np.float32(0.01)


@njit(**JIT)
def exp_minus(sigma):
    """``exp(-sigma)`` for sigma in [0, 5.6] to 1e-6 relative: a quintic fit to ``exp(-sigma / 8)``, squared thrice."""
    t = 0.125 * sigma
    p = 0.03977256130783281 - 0.005846759903538654 * t
    p = p * t - 0.1659739751367811
    p = p * t + 0.4998825872606345
    p = p * t - 0.999992539303225
    p = p * t + 0.9999999205127429
    p = p * p
    p = p * p
    return p * p


@njit(parallel=True, **JIT)
def find_spots(means, opacity, slices):
    """Spots (B, K, 6) of all Gaussians; one that is not to be drawn gets a half width of NaN, which meets no tile."""
    batch, count = opacity.shape
    spots = np.empty((batch, count, 6), np.float32)
    for frame in prange(batch):
        for k in range(count):
            cutoff = np.float32(math.log(np.float32(255.0) * opacity[frame, k]))
            spot = spots[frame, k]
            spot[X] = means[frame, k, 0]
            spot[Y] = means[frame, k, 1]
            spot[OPACITY] = opacity[frame, k]
            spot[CUTOFF] = cutoff
            spot[HALF_WIDTH] = math.sqrt(cutoff * slices[k, EXTENT_X])
            spot[HALF_HEIGHT] = math.sqrt(cutoff * slices[k, EXTENT_Y])
            finite = math.isfinite(spot[X]) and math.isfinite(spot[Y]) and math.isfinite(cutoff)
            if not (finite and cutoff >= ZERO):
                spot[HALF_WIDTH] = np.nan
    return spots


@njit(**JIT)
def meets(spot, left, top, columns, rows):
    """Whether the bounding box of a spot holds the centre of a pixel of the tile; False where it is NaN."""
    x = spot[X] - left
    y = spot[Y] - top
    inside_x = (x + spot[HALF_WIDTH] > ZERO) & (x - spot[HALF_WIDTH] < columns)
    return inside_x & (y + spot[HALF_HEIGHT] > ZERO) & (y - spot[HALF_HEIGHT] < rows)


@njit(**JIT)
def span(centre, reach, size):
    """First and one past the last of the pixels 0 ... size - 1 that lie within ``reach`` of ``centre``.

    Pixel i is at position i. Whatever the arguments, infinite or NaN, the result lies in [0, size].
    """
    first = centre - reach + ONE
    end = centre + reach + ONE
    first = first if first > ZERO else ZERO
    end = end if end > ZERO else ZERO
    return int(first if first < size else size), int(end if end < size else size)
