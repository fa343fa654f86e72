# mypy: ignore-errors
# (Numba infers the types of kernels.)
"""The runs of pixels that Gaussians cover in a tile, found for ``WIDTH`` Gaussians side by side.

Where a run begins follows from a square root, and how many there are is different for each Gaussian. A loop
that found the next run and blended it at once would wait for both. So the Gaussians that meet a tile are
gathered first, their runs are found row by row without a decision, and drawing only looks them up.

What is found is scaled so that sigma (see `lagsplat.splat.cpu.tiles`) costs two operations per pixel: with
``t = (ln(255 o) - sigma) / 8`` a pixel counts where ``t >= 0``, and its alpha depends on ``t`` alone.
"""

import numpy as np

from lagsplat.splat.cpu import simd, tiles
from lagsplat.splat.cpu.simd import (
    RUN,
    SUMS_AT_ONCE,
    WIDTH,
    compiled,
    load,
    maximum,
    minimum,
    select,
    splat,
    splat_runs,
    store,
)
from lagsplat.splat.cpu.tiles import COLUMNS, HALF, ONE, ROWS, ZERO

# Rows that are drawn at once.
AT_ONCE = WIDTH // RUN
# Gaussians are gathered until there are at least FULL, and at most a group of WIDTH more.
FULL = 64
_MOST = FULL + WIDTH
# A row more than a tile has: its last row may be drawn with the next.
_ROWS = (ROWS + 1) * WIDTH
# A list is two flat arrays, and functions take them apart from each other, because every tuple or slice of
# arrays counts references, which costs as much as to draw a few runs. Strips of the real numbers: parameters
# of the Gaussians gathered, ...
X, Y, CUTOFF, HALF_HEIGHT, SLOPE, PRECISION_X, PRECISION_Y, OPACITY, RED, GREEN, BLUE, _CROSSING = (
    strip * _MOST for strip in range(12)
)
# ..., and of a crossing of WIDTH Gaussians, lane by lane. Per row: scaled distance of the first pixel covered
# from the axis, t on the axis, height above the centre; number of pixels covered, place in the tile of the
# first and of the end of the row. Then the scale, and sums over the pixels of one Gaussian.
OFFSET, PEAK, HEIGHT, _NUMBER, _BEGIN, _BESIDE, SCALE = (_CROSSING + strip * _ROWS for strip in range(7))
SUMS = SCALE + WIDTH
_REALS = SUMS + SUMS_AT_ONCE
# Strips of the integers: indices of the Gaussians gathered; of a crossing, for the first, second, ... run of
# a row, the first row that has it, and one past the last; and where in the tile the run of each row begins.
_RUNS = COLUMNS // RUN
OWNER, FIRST = 0, _MOST
LAST = FIRST + _RUNS * WIDTH
PLACE = LAST + _RUNS * WIDTH
_INTEGERS = PLACE + _RUNS * _ROWS

EIGHTH = np.float32(0.125)
# Margin on the edge, which a square root finds; t of a pixel decides whether it counts.
RIM = np.float32(0.01)


@compiled()
def new_list():
    """The real numbers and the integers of an empty list."""
    return np.zeros(_REALS, np.float32), np.zeros(_INTEGERS, np.int32)


@compiled(inside=True)
def gather(reals, integers, at, spots, slices, color, k):
    """Put Gaussian ``k`` into a list as its Gaussian ``at``."""
    integers[at + OWNER] = k
    reals[at + X] = spots[tiles.X, k]
    reals[at + Y] = spots[tiles.Y, k]
    reals[at + OPACITY] = spots[tiles.OPACITY, k]
    reals[at + CUTOFF] = spots[tiles.CUTOFF, k]
    reals[at + HALF_HEIGHT] = spots[tiles.HALF_HEIGHT, k]
    reals[at + SLOPE] = slices[k, tiles.SLOPE]
    reals[at + PRECISION_X] = slices[k, tiles.PRECISION_X]
    reals[at + PRECISION_Y] = slices[k, tiles.PRECISION_Y]
    reals[at + RED] = color[k, 0]
    reals[at + GREEN] = color[k, 1]
    reals[at + BLUE] = color[k, 2]


@compiled(inside=True)
def cross(reals, integers, at, window, stride):
    """Find the runs of the ``WIDTH`` Gaussians from ``at`` on in a tile with ``stride`` values a row.

    Returns the number of runs in the longest row. Infinities and NaN give rows of no pixels: comparisons with
    NaN are false, and comparisons clip every bound to the tile.
    """
    top, left, rows, columns = window
    x = load(reals, at + X) - (np.float32(left) + HALF)
    y = load(reals, at + Y) - (np.float32(top) + HALF)
    half_height = load(reals, at + HALF_HEIGHT)
    precision = load(reals, at + PRECISION_X)
    variance = splat(ONE) / precision
    scale = simd.square_root(precision * EIGHTH)
    store(reals, SCALE, scale)
    first_row = pixels_before(y - half_height + ONE, rows)
    count = pixels_before(y + half_height + ONE, rows) - first_row
    crossed = int(simd.largest_lane(count))
    widest = splat(ZERO)
    for row in range(crossed + 1):  # the last may be drawn with the next
        here = row * WIDTH
        line = first_row + np.float32(row)
        height = line - y
        rest = load(reals, at + CUTOFF) - height * height * load(reals, at + PRECISION_Y)
        axis = height * load(reals, at + SLOPE) + x
        reach = simd.square_root(maximum(rest, splat(ZERO)) * variance) + RIM
        first = pixels_before(axis - reach + ONE, columns)
        number = pixels_before(axis + reach + ONE, columns) - first
        number = select(splat(np.float32(row)) < count, number, splat(ZERO))
        widest = maximum(widest, number)
        store(reals, here + OFFSET, (first - axis) * scale)
        store(reals, here + PEAK, rest * EIGHTH)
        store(reals, here + HEIGHT, height)
        store(reals, here + _NUMBER, number)
        store(reals, here + _BEGIN, line * np.float32(stride) + first)
        store(reals, here + _BESIDE, line * np.float32(stride) + np.float32(COLUMNS))
    return bound(reals, integers, crossed, int(simd.largest_lane(widest)))


@compiled()
def pixels_before(position, size):
    """How many of the pixels 0 ... size - 1 lie left of ``position``; 0 where it is NaN."""
    return simd.floor(minimum(maximum(position, splat(ZERO)), splat(np.float32(size))))


@compiled(inside=True)
def bound(reals, integers, rows, widest):
    """Find the rows that have a first, a second, ... run, and where it begins; return the number of runs.

    A row without it that is drawn with others gets the finished pixels beside its own.
    """
    runs = (widest + RUN - 1) // RUN
    for run in range(runs):
        first, last = splat(np.float32(ROWS)), splat(ZERO)
        for row in range(rows + 1):
            here, shift = row * WIDTH, np.float32(run * RUN)
            wide = load(reals, here + _NUMBER) > shift
            place = select(wide, load(reals, here + _BEGIN) + shift, load(reals, here + _BESIDE))
            simd.store_integers(integers, run * _ROWS + here + PLACE, place)
            first = minimum(first, select(wide, splat(np.float32(row)), splat(np.float32(ROWS))))
            last = select(wide, splat(np.float32(row + 1)), last)
        # A Gaussian is convex: rows between two that reach so far do so too, or nearly.
        simd.store_integers(integers, run * WIDTH + FIRST, first)
        simd.store_integers(integers, run * WIDTH + LAST, last)
    return runs


@compiled()
def look_up(reals, strip, row, lane):
    """What a strip of a crossing holds of one Gaussian, for the rows that are drawn at once from ``row``."""
    here = np.uint64(strip + row * WIDTH + lane)
    return splat_runs(reals[here], reals[here + np.uint64(WIDTH)])


@compiled()
def find_places(integers, run, row, lane):
    """Where in a tile the ``run``-th run of a row begins, and that of the next row."""
    here = np.uint64(PLACE + run * _ROWS + row * WIDTH + lane)
    return np.intp(integers[here]), np.intp(integers[here + np.uint64(WIDTH)])


@compiled()
def alpha_at(t):
    """``exp(8 t) / 255`` for t in [0, ln(255) / 8] to 2e-6: a quintic for the eighth root, squared thrice.

    In three short parts, which do not wait for each other.
    """
    square = t * t
    low = 0.500244641119121 + 0.5002489267305984 * t
    middle = 0.25004651209676926 + 0.08385779372390086 * t
    high = 0.01948149027767574 + 0.005869790486086243 * t
    p = low + square * (middle + square * high)
    p = p * p
    p = p * p
    return p * p
