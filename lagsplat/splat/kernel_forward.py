"""Forward kernel: each Gaussian, front to back, is blended into the pixels it covers."""

import math

import numpy as np
from numba import njit, prange

from lagsplat.splat.image_model import ALPHA_MAX, TRANSMITTANCE_MIN
from lagsplat.splat.kernel_tile import (
    COLUMNS,
    CUTOFF,
    HALF,
    HALF_HEIGHT,
    JIT,
    ONE,
    OPACITY,
    PITCH,
    PRECISION_X,
    PRECISION_Y,
    RIM,
    ROWS,
    SLOPE,
    STOP,
    X,
    Y,
    ZERO,
    exp_minus,
    meets,
    span,
)
from lagsplat.splat.lanes import WIDTH, count_up, least, load, select, spread, store

RED = 2 * PITCH
GREEN = 3 * PITCH
BLUE = 4 * PITCH
STRIDE = 5 * PITCH


@njit(**JIT)
def blend(tile, at, sigma, opacity, cutoff, index, red, green, blue):
    """Blend one Gaussian into the ``WIDTH`` pixels from ``at``."""
    alpha = least(opacity * exp_minus(sigma), spread(ALPHA_MAX))
    before = load(tile, at)
    weight = alpha * before
    after = before - weight
    stop = load(tile, at + STOP)
    live = (sigma <= cutoff) & (index < stop)
    composited = live & (TRANSMITTANCE_MIN < after)
    weight = select(composited, weight, spread(ZERO))
    store(tile, at, select(composited, after, before))
    store(tile, at + STOP, select(live & (after <= TRANSMITTANCE_MIN), spread(index), stop))
    store(tile, at + RED, load(tile, at + RED) + weight * red)
    store(tile, at + GREEN, load(tile, at + GREEN) + weight * green)
    store(tile, at + BLUE, load(tile, at + BLUE) + weight * blue)


@njit(**JIT)
def draw(tile, spots, slices, color, left, top, columns, rows):
    """Draw all spots of a frame into a tile whose first pixel is (left, top)."""
    for k in range(spots.shape[0]):
        spot = spots[k]
        if not meets(spot, left, top, columns, rows):
            continue
        x = spot[X] - left - HALF
        y = spot[Y] - top - HALF
        cutoff = spot[CUTOFF]
        opacity = spot[OPACITY]
        slope = slices[k, SLOPE]
        precision_x = slices[k, PRECISION_X]
        precision_y = slices[k, PRECISION_Y]
        red, green, blue = color[k, 0], color[k, 1], color[k, 2]
        first_row, end_row = span(y, spot[HALF_HEIGHT], rows)
        for row in range(first_row, end_row):
            dy = np.float32(row) - y
            base = dy * dy * precision_y
            centre = x + slope * dy
            reach = math.sqrt(max(cutoff - base, ZERO) / precision_x) + RIM
            first, end = span(centre, reach, columns)
            for column in range(first, end, WIDTH):
                u = count_up() + (np.float32(column) - centre)
                sigma = u * u * precision_x + base
                blend(tile, row * STRIDE + column, sigma, opacity, cutoff, np.float32(k), red, green, blue)


@njit(**JIT)
def blank(tile, columns, count):
    """A tile before anything is drawn; only its first ``columns`` columns can be drawn upon."""
    tile[:] = ZERO
    for row in range(ROWS):
        for column in range(columns):
            tile[row * STRIDE + column] = ONE
            tile[row * STRIDE + STOP + column] = np.float32(count)


@njit(parallel=True, **JIT)
def forward(spots, slices, color, background, height, width):
    """Images (B, 3, H, W), and per pixel the final transmittance and the index that finished it, (B, 2, H, W)."""
    batch, count = spots.shape[:2]
    across = (width + COLUMNS - 1) // COLUMNS
    down = (height + ROWS - 1) // ROWS
    images = np.empty((batch, 3, height, width), np.float32)
    state = np.empty((batch, 2, height, width), np.float32)
    for task in prange(batch * down * across):
        frame = task // (down * across)
        top = task // across % down * ROWS
        left = task % across * COLUMNS
        rows = min(ROWS, height - top)
        columns = min(COLUMNS, width - left)
        tile = np.empty(ROWS * STRIDE, np.float32)
        blank(tile, columns, count)
        draw(
            tile,
            spots[frame],
            slices,
            color,
            np.float32(left),
            np.float32(top),
            np.float32(columns),
            np.float32(rows),
        )
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
