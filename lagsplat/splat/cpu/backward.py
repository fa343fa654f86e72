# mypy: ignore-errors
# (Numba infers the types of kernels.)
"""Backward kernel: remove each Gaussian, back to front, from the pixels it covers.

The transmittance in front of a Gaussian is the one behind it divided by ``1 - alpha``, and the light from
behind accumulates on the way, so the forward pass stores nothing per Gaussian and pixel.
"""

import numpy as np
from numba import prange

from lagsplat.splat.cpu import tiles
from lagsplat.splat.cpu.simd import WIDTH, compiled, iota, load, minimum, select, splat, store, sum_lanes
from lagsplat.splat.cpu.tiles import BLUE, GREEN, PRECISION_X, PRECISION_Y, RED, STOP, TWO, ZERO
from lagsplat.splat.image_model import ALPHA_MAX

BEHIND, STRIDE = 5 * tiles.PITCH, 6 * tiles.PITCH


@compiled(parallel=True)
def backward(spots, slices, color, background, state, grad, workers):
    """Gradients of the loss with respect to the spots' X, Y, OPACITY, and to the slices and colours.

    ``state`` is the forward kernel's, ``grad`` the gradient of its images, ``workers`` the number of threads.
    The first gradients come as (shares, B, K, 3), the others (SLOPE, PRECISION_X, PRECISION_Y, red, green,
    blue) as (workers, 1, K, 6), or (shares, B, K, 6) where each frame has its own slices. The caller sums
    over the first axis. A frame is split into shares only if there are fewer frames than workers.
    """
    batch, count = len(spots), slices.shape[1]
    height, width = grad.shape[2:]
    number = tiles.count_tiles(height, width)
    shares = min(number, (workers + batch - 1) // max(batch, 1))
    spot_grad = np.zeros((shares, batch, count, 3), np.float32)
    single = len(slices) == 1
    shared_grad = np.zeros((workers if single else shares, len(slices), count, 6), np.float32)
    for thread in prange(workers):
        worker = np.int64(thread)
        for task in range(worker, batch * shares, workers):
            frame, share = task // shares, task % shares
            own = frame % len(slices)
            for part in range(share, number, shares):
                window = tiles.place(part, height, width)
                tile = fill(state[frame], grad[frame], background, window)
                grads = (spot_grad[share, frame], shared_grad[worker if single else share, own])
                undraw(grads, tile, spots[frame], slices[own], color[own], window)
    return spot_grad, shared_grad


@compiled()
def fill(state, grad, background, window):
    """Restore a tile as the forward kernel left it, with the loss gradient of its pixels."""
    top, left, rows, columns = window
    tile = np.zeros(tiles.ROWS * STRIDE, np.float32)
    for row in range(rows):
        for column in range(columns):
            at = row * STRIDE + column
            y, x = top + row, left + column
            red, green, blue = grad[0, y, x], grad[1, y, x], grad[2, y, x]
            tile[at] = state[0, y, x]
            tile[at + STOP] = state[1, y, x]
            tile[at + RED] = red
            tile[at + GREEN] = green
            tile[at + BLUE] = blue
            light = background[0] * red + background[1] * green + background[2] * blue
            tile[at + BEHIND] = state[0, y, x] * light
    return tile


@compiled()
def undraw(grads, tile, spots, slices, color, window):
    """Remove the spots (6, K) of a frame from one of its tiles and add to both gradients."""
    spot_grad, shared_grad = grads
    crossing = np.empty(tiles.CROSSING, np.float32)
    for group in range(spots.shape[1] - WIDTH, -1, -WIDTH):
        met = tiles.meeting(spots, group, window)
        for lane in range(WIDTH - 1, -1, -1):
            if met >> lane & 1:
                k = group + lane
                spot, shape = spots[:, k], slices[k]
                crossed = tiles.cross(crossing, spot, shape, window)
                of_spot = (spot_grad[k], shared_grad[k])
                undraw_spot(of_spot, tile, crossing, crossed, spot, shape, color[k], np.float32(k))


@compiled()
def undraw_spot(grads, tile, crossing, crossed, spot, shape, color, index):
    """Remove one spot from the rows of a tile that it crosses."""
    spot_grad, shared_grad = grads
    first_row, count, widest = crossed
    rgb = color[0], color[1], color[2]
    # Moments of g = dL/dsigma over the pixels: u is the distance from the axis, h the height over the centre.
    g = g_u = g_h = g_uu = g_uh = g_hh = splat(ZERO)
    to_red = to_green = to_blue = splat(ZERO)
    for shift in range(0, widest, WIDTH):
        for row in range(count):
            column = crossing[row + tiles.FIRST] + np.float32(shift)
            if column < crossing[row + tiles.END]:
                u = iota() + (crossing[row + tiles.OFFSET] + np.float32(shift))
                h = crossing[row + tiles.HEIGHT]
                sigma = u * u * shape[PRECISION_X] + crossing[row + tiles.BASE]
                at = (first_row + row) * STRIDE + int(column)
                here, weight = unblend(tile, at, sigma, spot, index, rgb)
                to_red = to_red + weight * load(tile, at + RED)
                to_green = to_green + weight * load(tile, at + GREEN)
                to_blue = to_blue + weight * load(tile, at + BLUE)
                here_u, here_h = here * u, here * h
                g, g_u, g_h = g + here, g_u + here_u, g_h + here_h
                g_uu, g_uh, g_hh = g_uu + here_u * u, g_uh + here_u * h, g_hh + here_h * h
    pull_x = TWO * shape[PRECISION_X] * sum_lanes(g_u)
    spot_grad[0] -= pull_x
    spot_grad[1] += shape[tiles.SLOPE] * pull_x - TWO * shape[PRECISION_Y] * sum_lanes(g_h)
    spot_grad[2] -= sum_lanes(g) / spot[tiles.OPACITY]
    shared_grad[0] -= TWO * shape[PRECISION_X] * sum_lanes(g_uh)
    shared_grad[1] += sum_lanes(g_uu)
    shared_grad[2] += sum_lanes(g_hh)
    shared_grad[3] += sum_lanes(to_red)
    shared_grad[4] += sum_lanes(to_green)
    shared_grad[5] += sum_lanes(to_blue)


@compiled()
def unblend(tile, at, sigma, spot, index, rgb):
    """Remove one Gaussian from the ``WIDTH`` pixels from ``at``; return dL/dsigma and its weight in each."""
    covered = spot[tiles.OPACITY] * tiles.exp_minus(sigma)
    live = (sigma <= spot[tiles.CUTOFF]) & (index < load(tile, at + STOP))
    alpha = select(live, minimum(covered, splat(ALPHA_MAX)), splat(ZERO))
    inverse = 1.0 / (1.0 - alpha)
    before = load(tile, at) * inverse
    weight = alpha * before
    red, green, blue = load(tile, at + RED), load(tile, at + GREEN), load(tile, at + BLUE)
    own = rgb[0] * red + rgb[1] * green + rgb[2] * blue
    behind = load(tile, at + BEHIND)
    store(tile, at, before)
    store(tile, at + BEHIND, behind + weight * own)
    # The clamp has no gradient, nor have pixels far outside, where `covered` is arbitrary but alpha is 0.
    return select(covered < ALPHA_MAX, alpha * (behind * inverse - before * own), splat(ZERO)), weight
