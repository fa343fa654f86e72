# mypy: ignore-errors
# (Numba infers the types of kernels.)
"""Forward kernel: blend each Gaussian, front to back, into the pixels it covers."""

import numpy as np
from numba import prange

from lagsplat.splat.cpu import tiles
from lagsplat.splat.cpu.simd import WIDTH, compiled, iota, load, minimum, select, splat, store, to_bits
from lagsplat.splat.cpu.tiles import BLUE, GREEN, RED, STOP, ZERO
from lagsplat.splat.image_model import ALPHA_MAX, TRANSMITTANCE_MIN

STRIDE = 5 * tiles.PITCH


@compiled(parallel=True)
def forward(spots, slices, color, background, height, width):
    """Draw spots (B, 6, K), see `find_spots`, of slices (S, K, 5) and colours (S, K, 3), with S = 1 or B.

    Returns the images (B, 3, H, W), and final transmittance and finishing index (B, 2, H, W).
    """
    batch, count = len(spots), slices.shape[1]
    images = np.empty((batch, 3, height, width), np.float32)
    state = np.empty((batch, 2, height, width), np.float32)
    number = tiles.count_tiles(height, width)
    for task in prange(batch * number):
        frame = task // number
        window = tiles.place(task % number, height, width)
        top, left, rows, columns = window
        tile = blank(columns, count)
        own = frame % len(slices)
        draw(tile, spots[frame], slices[own], color[own], window)
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
    tile = np.zeros(tiles.ROWS * STRIDE, np.float32)
    for row in range(tiles.ROWS):
        for column in range(columns):
            tile[row * STRIDE + column] = tiles.ONE
            tile[row * STRIDE + STOP + column] = np.float32(count)
    return tile


@compiled()
def draw(tile, spots, slices, color, window):
    """Draw the spots (6, K) of a frame into one of its tiles."""
    crossing = np.empty(tiles.CROSSING, np.float32)
    for group in range(0, spots.shape[1], WIDTH):
        met = tiles.meeting(spots, group, window)
        for lane in range(WIDTH):
            if met >> lane & 1:
                k = group + lane
                spot, shape = spots[:, k], slices[k]
                crossed = tiles.cross(crossing, spot, shape, window)
                draw_spot(tile, crossing, crossed, spot, shape, color[k], np.float32(k))


@compiled()
def draw_spot(tile, crossing, crossed, spot, shape, color, index):
    """Draw one spot where it crosses the rows of a tile."""
    first_row, count, widest = crossed
    rgb = color[0], color[1], color[2]
    for shift in range(0, widest, WIDTH):
        for row in range(count):
            column = crossing[row + tiles.FIRST] + np.float32(shift)
            if column < crossing[row + tiles.END]:
                u = iota() + (crossing[row + tiles.OFFSET] + np.float32(shift))
                sigma = u * u * shape[tiles.PRECISION_X] + crossing[row + tiles.BASE]
                at = (first_row + row) * STRIDE + int(column)
                blend(tile, at, sigma, spot, index, rgb)


@compiled()
def blend(tile, at, sigma, spot, index, rgb):
    """Blend one Gaussian into the ``WIDTH`` pixels from ``at``."""
    alpha = minimum(spot[tiles.OPACITY] * tiles.exp_minus(sigma), splat(ALPHA_MAX))
    before = load(tile, at)
    stop = load(tile, at + STOP)
    after = before - alpha * before
    live = (sigma <= spot[tiles.CUTOFF]) & (index < stop)
    finished = live & (after <= TRANSMITTANCE_MIN)
    weight = select(live & (after > TRANSMITTANCE_MIN), alpha * before, splat(ZERO))
    store(tile, at, before - weight)
    store(tile, at + RED, load(tile, at + RED) + weight * rgb[0])
    store(tile, at + GREEN, load(tile, at + GREEN) + weight * rgb[1])
    store(tile, at + BLUE, load(tile, at + BLUE) + weight * rgb[2])
    if to_bits(finished):
        store(tile, at + STOP, select(finished, splat(index), stop))
