"""Backward kernel: each Gaussian, back to front, is taken out of the pixels it covers.

The transmittance before a Gaussian is the one after it divided by ``1 - alpha``, and the light from behind it is
summed on the way; so nothing per pair needs to be stored by the forward pass.
"""

import math

import numpy as np
from numba import njit, prange

from lagsplat.splat.image_model import ALPHA_MAX
from lagsplat.splat.kernel_tile import (
    COLUMNS,
    CUTOFF,
    HALF,
    HALF_HEIGHT,
    JIT,
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
from lagsplat.splat.lanes import WIDTH, count_up, least, load, select, spread, store, total

RED = 2 * PITCH
GREEN = 3 * PITCH
BLUE = 4 * PITCH
BEHIND = 5 * PITCH
STRIDE = 6 * PITCH


@njit(**JIT)
def unblend(tile, at, sigma, opacity, cutoff, index, red, green, blue):
    """Undo `blend`; returns ``dL/dsigma``, and ``dL/dcolor`` as three, each per pixel."""
    covered = opacity * exp_minus(sigma)
    live = (sigma <= cutoff) & (index < load(tile, at + STOP))
    alpha = select(live, least(covered, spread(ALPHA_MAX)), spread(ZERO))
    inverse = 1.0 / (1.0 - alpha)
    before = load(tile, at) * inverse
    weight = alpha * before
    grad_red = load(tile, at + RED)
    grad_green = load(tile, at + GREEN)
    grad_blue = load(tile, at + BLUE)
    own = red * grad_red + green * grad_green + blue * grad_blue
    behind = load(tile, at + BEHIND)
    store(tile, at, before)
    store(tile, at + BEHIND, behind + weight * own)
    # The clamp passes no gradient on. Lanes that are not live have alpha 0 here, but perhaps an infinite `covered`.
    grad_sigma = select(covered < ALPHA_MAX, alpha * (behind * inverse - before * own), spread(ZERO))
    return grad_sigma, weight * grad_red, weight * grad_green, weight * grad_blue


@njit(**JIT)
def undraw(tile, spots, slices, color, left, top, columns, rows, spot_grad, slice_grad):
    """Take all spots out of a tile again, adding their gradients to ``spot_grad`` (K, 3) and ``slice_grad`` (K, 6)."""
    for k in range(spots.shape[0] - 1, -1, -1):
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
        p = spread(ZERO)
        p_u = spread(ZERO)
        p_uu = spread(ZERO)
        p_dy = spread(ZERO)
        p_u_dy = spread(ZERO)
        p_dy_dy = spread(ZERO)
        sum_red = spread(ZERO)
        sum_green = spread(ZERO)
        sum_blue = spread(ZERO)
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
                g, r, gr, b = unblend(
                    tile, row * STRIDE + column, sigma, opacity, cutoff, np.float32(k), red, green, blue
                )
                sum_red = sum_red + r
                sum_green = sum_green + gr
                sum_blue = sum_blue + b
                gu = g * u
                gdy = g * dy
                p = p + g
                p_u = p_u + gu
                p_dy = p_dy + gdy
                p_uu = p_uu + gu * u
                p_u_dy = p_u_dy + gu * dy
                p_dy_dy = p_dy_dy + gdy * dy
        pu = total(p_u)
        spot_grad[k, 0] += -np.float32(2.0) * precision_x * pu
        spot_grad[k, 1] += np.float32(2.0) * (slope * precision_x * pu - precision_y * total(p_dy))
        spot_grad[k, 2] += -total(p) / opacity
        slice_grad[k, 0] += -np.float32(2.0) * precision_x * total(p_u_dy)
        slice_grad[k, 1] += total(p_uu)
        slice_grad[k, 2] += total(p_dy_dy)
        slice_grad[k, 3] += total(sum_red)
        slice_grad[k, 4] += total(sum_green)
        slice_grad[k, 5] += total(sum_blue)


@njit(**JIT)
def fill(tile, state, grad, background, left, top, columns, rows):
    """A tile as `forward` left it, with the gradient of the loss in its pixels."""
    tile[:] = ZERO
    for row in range(rows):
        for column in range(columns):
            at = row * STRIDE + column
            y, x = top + row, left + column
            tile[at] = state[0, y, x]
            tile[at + STOP] = state[1, y, x]
            tile[at + RED] = grad[0, y, x]
            tile[at + GREEN] = grad[1, y, x]
            tile[at + BLUE] = grad[2, y, x]
            light = (
                background[0] * grad[0, y, x] + background[1] * grad[1, y, x] + background[2] * grad[2, y, x]
            )
            tile[at + BEHIND] = state[0, y, x] * light


@njit(parallel=True, **JIT)
def backward(spots, slices, color, background, state, grad, workers):
    batch, count = spots.shape[:2]
    height, width = grad.shape[2:]
    across = (width + COLUMNS - 1) // COLUMNS
    down = (height + ROWS - 1) // ROWS
    spot_grad = np.zeros((batch, count, 3), np.float32)
    slice_grad = np.zeros((workers, count, 6), np.float32)
    for worker in prange(workers):
        tile = np.empty(ROWS * STRIDE, np.float32)
        for frame in range(worker, batch, workers):
            for task in range(down * across):
                top = task // across * ROWS
                left = task % across * COLUMNS
                rows = min(ROWS, height - top)
                columns = min(COLUMNS, width - left)
                fill(tile, state[frame], grad[frame], background, left, top, columns, rows)
                undraw(
                    tile,
                    spots[frame],
                    slices,
                    color,
                    np.float32(left),
                    np.float32(top),
                    np.float32(columns),
                    np.float32(rows),
                    spot_grad[frame],
                    slice_grad[worker],
                )
    return spot_grad, slice_grad
