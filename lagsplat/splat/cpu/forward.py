# mypy: ignore-errors
# (Numba infers the types of kernels.)
"""Forward kernel: blend each Gaussian, front to back, into the pixels it covers."""

import numpy as np
from numba import prange

from lagsplat.splat.cpu.simd import WIDTH, compiled, iota, load, minimum, select, splat, store, to_bits
from lagsplat.splat.cpu.tile import (
    BASE,
    CROSSING,
    CUTOFF,
    END,
    FIRST,
    OFFSET,
    ONE,
    OPACITY,
    PITCH,
    PRECISION_X,
    ROWS,
    STOP,
    ZERO,
    cross,
    exp_minus,
    meeting,
    place,
    tiles,
)
from lagsplat.splat.image_model import ALPHA_MAX, TRANSMITTANCE_MIN

RED = 2 * PITCH
GREEN = 3 * PITCH
BLUE = 4 * PITCH
STRIDE = 5 * PITCH


@compiled(parallel=True)
def forward(spots, slices, color, background, height, width):
    """Draw all frames in parallel.

    Args:
        spots: (B, 6, K), see `find_spots`.
        slices, color: (S, K, 5) and (S, K, 3), with S = 1 or B.
        background: (3,).
        height, width: Size of the images [px].

    Returns the images (B, 3, H, W), and final transmittance and finishing index (B, 2, H, W).
    """
    batch, count = len(spots), slices.shape[1]
    images = np.empty((batch, 3, height, width), np.float32)
    state = np.empty((batch, 2, height, width), np.float32)
    for task in prange(batch * tiles(height, width)):
        frame = task // tiles(height, width)
        top, left, rows, columns = place(task % tiles(height, width), height, width)
        tile = blank(columns, count)
        own = frame % len(slices)
        draw(tile, spots[frame], slices[own], color[own], top, left, rows, columns)
        for row in range(rows):
            for column in range(columns):
                at = row * STRIDE + column
                y, x = top + row, left + column
                state[frame, 0, y, x] = tile[at]
                state[frame, 1, y, x] = tile[at + STOP]
                images[frame, 0, y, x] = tile[at + RED] + tile[at] * background[0]
                images[frame, 1, y, x] = tile[at + GREEN] + tile[at] * background[1]
                images[frame, 2, y, x] = tile[at + BLUE] + tile[at] * background[2]
    return images, state


@compiled()
def blank(columns, count):
    """An empty tile for ``count`` Gaussians; only its first ``columns`` columns are drawn."""
    tile = np.zeros(ROWS * STRIDE, np.float32)
    for row in range(ROWS):
        for column in range(columns):
            tile[row * STRIDE + column] = ONE
            tile[row * STRIDE + STOP + column] = np.float32(count)
    return tile


@compiled()
def draw(tile, spots, slices, color, top, left, rows, columns):
    """Draw the spots (6, K) of a frame into one of its tiles."""
    crossing = np.empty(CROSSING, np.float32)
    for group in range(0, spots.shape[1], WIDTH):
        met = meeting(spots, group, top, left, rows, columns)
        for lane in range(WIDTH):
            if met >> lane & 1:
                k = group + lane
                spot, shape = spots[:, k], slices[k]
                first_row, count, widest = cross(crossing, spot, shape, top, left, rows, columns)
                draw_spot(tile, crossing, first_row, count, widest, spot, shape, color[k], np.float32(k))


@compiled()
def draw_spot(tile, crossing, first_row, count, widest, spot, shape, color, index):
    """Draw one spot where it crosses the rows of a tile."""
    red, green, blue = color[0], color[1], color[2]
    for shift in range(0, widest, WIDTH):
        for row in range(count):
            column = crossing[row + FIRST] + np.float32(shift)
            if column < crossing[row + END]:
                u = iota() + (crossing[row + OFFSET] + np.float32(shift))
                sigma = u * u * shape[PRECISION_X] + crossing[row + BASE]
                at = (first_row + row) * STRIDE + int(column)
                blend(tile, at, sigma, spot[OPACITY], spot[CUTOFF], index, red, green, blue)


@compiled()
def blend(tile, at, sigma, opacity, cutoff, index, red, green, blue):
    """Blend one Gaussian into the ``WIDTH`` pixels from ``at``."""
    alpha = minimum(opacity * exp_minus(sigma), splat(ALPHA_MAX))
    before = load(tile, at)
    stop = load(tile, at + STOP)
    after = before - alpha * before
    live = (sigma <= cutoff) & (index < stop)
    finished = live & (after <= TRANSMITTANCE_MIN)
    weight = select(live & (after > TRANSMITTANCE_MIN), alpha * before, splat(ZERO))
    store(tile, at, before - weight)
    store(tile, at + RED, load(tile, at + RED) + weight * red)
    store(tile, at + GREEN, load(tile, at + GREEN) + weight * green)
    store(tile, at + BLUE, load(tile, at + BLUE) + weight * blue)
    if to_bits(finished):
        store(tile, at + STOP, select(finished, splat(index), stop))
