# mypy: ignore-errors
# (Numba infers the types of kernels.)
"""What the forward and backward kernels share: the tile, and how a Gaussian crosses it.

A tile is a flat float32 array. Row by row it holds strips of ``PITCH`` values: transmittance, the index of
the Gaussian that finished each pixel, and whatever the kernel adds. The strips of a row lie side by side,
because planes a multiple of 4 KiB apart delay each other's loads. After the ``COLUMNS`` pixels of a row come
``WIDTH`` more that are finished from the start, so a run of ``WIDTH`` pixels may begin at any pixel.

Along row ``y`` a Gaussian is one-dimensional. With ``dy = y - m_y`` and the blurred covariance ``S``,

    sigma = dy^2 / (2 S_yy) + (x - m_x - slope dy)^2 / (2 v),  slope = S_xy / S_yy,  v = S_xx - S_xy^2 / S_yy.

That costs one square per pixel, gives the exact pixels with ``sigma <= ln(255 o)``, and keeps all digits for
narrow Gaussians, where the inverse covariance would not.
"""

import math

import numpy as np
from numba import prange

from lagsplat.splat.cpu import simd
from lagsplat.splat.cpu.simd import WIDTH, compiled, load, splat, store

ROWS = 32
COLUMNS = 32
PITCH = COLUMNS + WIDTH
STOP, RED, GREEN, BLUE = PITCH, 2 * PITCH, 3 * PITCH, 4 * PITCH

# Rows of the spots (6, K) of a frame. K is padded to a multiple of WIDTH.
X, Y, OPACITY, CUTOFF, HALF_WIDTH, HALF_HEIGHT = range(6)
# Columns of a slice (S, K, 5), S = 1 where all frames share their shapes:
# slope, 1 / (2 v), 1 / (2 S_yy), sqrt(2 S_xx), sqrt(2 S_yy).
SLOPE, PRECISION_X, PRECISION_Y, EXTENT_X, EXTENT_Y = range(5)
# Strips of a crossing: per row, first column covered and one past the last; for the former the distance
# from the Gaussian's axis; height above its centre; sigma on the axis.
FIRST, END, OFFSET, HEIGHT, BASE = (strip * (ROWS + WIDTH) for strip in range(5))
CROSSING = 5 * (ROWS + WIDTH)

ZERO = np.float32(0.0)
HALF = np.float32(0.5)
ONE = np.float32(1.0)
TWO = np.float32(2.0)
# Margin on the edge, which a square root finds; the sigma of a pixel decides whether it counts.
RIM = np.float32(0.01)


@compiled(parallel=True)
def find_spots(means, opacity, cutoff, slices):
    """Spots (B, 6, K) of all frames; a Gaussian not drawn gets a half width of NaN and meets no tile.

    ``cutoff`` is ``ln(255 opacity)``, the largest sigma that is drawn.
    """
    batch, count = opacity.shape
    spots = np.full((batch, 6, (count + WIDTH - 1) // WIDTH * WIDTH), np.nan, np.float32)
    for frame in prange(batch):
        own = slices[frame % len(slices)]
        for k in range(count):
            x, y, limit = means[frame, k, 0], means[frame, k, 1], cutoff[frame, k]
            drawn = math.isfinite(x) and math.isfinite(y) and math.isfinite(limit) and limit >= ZERO
            root = math.sqrt(limit) if drawn else np.float32(np.nan)
            spots[frame, X, k] = x
            spots[frame, Y, k] = y
            spots[frame, OPACITY, k] = opacity[frame, k]
            spots[frame, CUTOFF, k] = limit
            spots[frame, HALF_WIDTH, k] = root * own[k, EXTENT_X]
            spots[frame, HALF_HEIGHT, k] = root * own[k, EXTENT_Y]
    return spots


@compiled()
def count_tiles(height, width):
    """Number of tiles in an image."""
    return (height + ROWS - 1) // ROWS * ((width + COLUMNS - 1) // COLUMNS)


@compiled()
def place(tile, height, width):
    """The window of a tile in its image: first row and column, numbers of rows and columns."""
    across = (width + COLUMNS - 1) // COLUMNS
    top = tile // across * ROWS
    left = tile % across * COLUMNS
    return top, left, min(ROWS, height - top), min(COLUMNS, width - left)


@compiled()
def meeting(spots, k, window):
    """Which of the ``WIDTH`` spots from ``k`` on reach into the tile, as bits; those with NaN do not."""
    top, left, rows, columns = window
    count = spots.shape[1]
    x = load(spots, X * count + k) - np.float32(left)
    y = load(spots, Y * count + k) - np.float32(top)
    half_width = load(spots, HALF_WIDTH * count + k)
    half_height = load(spots, HALF_HEIGHT * count + k)
    inside_x = (x + half_width > ZERO) & (x - half_width < np.float32(columns))
    return simd.to_bits(inside_x & (y + half_height > ZERO) & (y - half_height < np.float32(rows)))


@compiled()
def cross(crossing, spot, shape, window):
    """Fill in where a spot with slice ``shape`` crosses the rows of a tile, in pixels of the tile.

    Returns the first row, the number of rows, and the width of the widest [px]. Infinities and NaN give rows
    of zero width: comparisons with NaN are false, and comparisons clip every bound to the tile.
    """
    top, left, rows, columns = window
    x = spot[X] - np.float32(left) - HALF
    y = spot[Y] - np.float32(top) - HALF
    cutoff = spot[CUTOFF]
    variance = ONE / shape[PRECISION_X]
    first_row = clip(y - spot[HALF_HEIGHT] + ONE, rows)
    count = clip(y + spot[HALF_HEIGHT] + ONE, rows) - first_row
    nothing = splat(ZERO)
    everything = splat(np.float32(columns))
    for row in range(0, count, WIDTH):
        height = simd.iota() + (np.float32(first_row + row) - y)
        base = height * height * shape[PRECISION_Y]
        axis = height * shape[SLOPE] + x
        reach = simd.square_root(simd.maximum(cutoff - base, nothing) * variance) + RIM
        first = simd.floor(simd.minimum(simd.maximum(axis - reach + ONE, nothing), everything))
        end = simd.floor(simd.minimum(simd.maximum(axis + reach + ONE, nothing), everything))
        store(crossing, row + FIRST, first)
        store(crossing, row + END, end)
        store(crossing, row + OFFSET, first - axis)
        store(crossing, row + HEIGHT, height)
        store(crossing, row + BASE, base)
    return first_row, count, clip(TWO * (math.sqrt(cutoff * variance) + RIM) + ONE, columns)


@compiled()
def clip(position, size):
    """How many of the pixels 0 ... size - 1 lie left of ``position``; 0 where it is NaN."""
    position = position if position > ZERO else ZERO
    return int(position if position < np.float32(size) else np.float32(size))


@compiled()
def exp_minus(sigma):
    """``exp(-sigma)`` for sigma in [0, 5.6] to 1e-6: a quintic for the eighth root, squared thrice."""
    t = 0.125 * sigma
    p = 0.03977256130783281 - 0.005846759903538654 * t
    p = p * t - 0.1659739751367811
    p = p * t + 0.4998825872606345
    p = p * t - 0.999992539303225
    p = p * t + 0.9999999205127429
    p = p * p
    p = p * p
    return p * p
