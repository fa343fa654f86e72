# mypy: ignore-errors
# (Numba infers the types of kernels.)
"""What the forward and backward kernels share: the tile, and which Gaussians meet it.

A tile is a flat float32 array. Row by row it holds strips of ``PITCH`` values: transmittance, the index of
the Gaussian that finished each pixel, and whatever the kernel adds. The strips of a row lie side by side,
because planes a multiple of 4 KiB apart delay each other's loads. After the ``COLUMNS`` pixels of a row come
``RUN`` more that are finished from the start, so a run of ``RUN`` pixels may begin at any pixel. After the
``ROWS`` rows comes one more that is finished, for pixels that are drawn with others but lie below the tile.

Along row ``y`` a Gaussian is one-dimensional. With ``dy = y - m_y`` and the blurred covariance ``S``,

    sigma = dy^2 / (2 S_yy) + (x - m_x - slope dy)^2 / (2 v),  slope = S_xy / S_yy,  v = S_xx - S_xy^2 / S_yy.

That costs one square per pixel, gives the exact pixels with ``sigma <= ln(255 o)``, and keeps all digits for
narrow Gaussians, where the inverse covariance would not. `lagsplat.splat.cpu.runs` finds these pixels.
"""

import math

import numpy as np
from numba import prange

from lagsplat.splat.cpu import simd
from lagsplat.splat.cpu.simd import RUN, compiled, load

ROWS = 32
COLUMNS = 32
LINES, PITCH = ROWS + 1, COLUMNS + RUN
STOP, RED, GREEN, BLUE = PITCH, 2 * PITCH, 3 * PITCH, 4 * PITCH

# Rows of the spots (6, K) of a frame. K is padded to a multiple of WIDTH.
X, Y, OPACITY, CUTOFF, HALF_WIDTH, HALF_HEIGHT = range(6)
# Columns of a slice (S, K, 5), S = 1 where all frames share their shapes:
# slope, 1 / (2 v), 1 / (2 S_yy), sqrt(2 S_xx), sqrt(2 S_yy).
SLOPE, PRECISION_X, PRECISION_Y, EXTENT_X, EXTENT_Y = range(5)

ZERO = np.float32(0.0)
HALF = np.float32(0.5)
ONE = np.float32(1.0)
TWO = np.float32(2.0)


@compiled(parallel=True)
def find_spots(spots, means, opacity, cutoff, slices):
    """Fill in the spots (B, 6, K) of all frames; one not drawn gets a half width of NaN and meets no tile.

    ``cutoff`` is ``ln(255 opacity)``, the largest sigma that is drawn.
    """
    count = opacity.shape[1]
    # Rows over the Gaussians, as the spots are: so the last loop runs several at once.
    extents = np.ascontiguousarray(slices.transpose(0, 2, 1)[:, EXTENT_X:])
    for frame in prange(len(spots)):
        own = extents[frame % len(slices)]
        spots[frame, OPACITY, :count] = opacity[frame]
        spots[frame, CUTOFF, :count] = cutoff[frame]
        spots[frame, HALF_WIDTH, count:] = np.float32(np.nan)
        for k in range(count):
            spots[frame, X, k] = means[frame, k, 0]
            spots[frame, Y, k] = means[frame, k, 1]
        for k in range(count):
            x, y, limit = spots[frame, X, k], spots[frame, Y, k], spots[frame, CUTOFF, k]
            # What is not finite leaves NaN, and so does a negative limit.
            root = math.sqrt(limit) + (x - x) + (y - y) + (limit - limit)
            spots[frame, HALF_WIDTH, k] = root * own[0, k]
            spots[frame, HALF_HEIGHT, k] = root * own[1, k]


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
