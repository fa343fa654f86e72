# mypy: ignore-errors
# (Numba infers the types of kernels.)
"""Backward kernel: remove each Gaussian, back to front, from the pixels it covers.

The transmittance in front of a Gaussian is the one behind it divided by ``1 - alpha``. The light from behind,
as if nothing stood before it, is blended with the Gaussian's own on the way. So the forward pass stores
nothing per Gaussian and pixel.
"""

import numpy as np
from numba import prange

from lagsplat.splat.cpu import runs, tiles
from lagsplat.splat.cpu.simd import (
    RUN,
    WIDTH,
    compiled,
    leading_zeros,
    load_runs,
    minimum,
    ramp,
    select,
    splat,
    store_runs,
    store_sums,
    sum_lanes,
)
from lagsplat.splat.cpu.tiles import BLUE, GREEN, RED, STOP, TWO, ZERO
from lagsplat.splat.image_model import ALPHA_MAX

BEHIND, STRIDE = 5 * tiles.PITCH, 6 * tiles.PITCH
SIXTEEN = np.float32(16.0)
# A batch is summed in parts, as many whatever the number of threads: so rounding does not depend on it. Most
# numbers of threads share 24 evenly.
PARTS = 24
# With fewer frames, each is divided into shares of its tiles, so that there are at least so many tasks.
FEWEST_TASKS = 8


@compiled(parallel=True)
def backward(spots, slices, color, background, state, grad):
    """Gradients of the loss with respect to the spots' X, Y, OPACITY, and to the slices and colours.

    ``state`` is the forward kernel's, ``grad`` the gradient of its images. The first gradients come as
    (shares, B, K, 3), the others (SLOPE, PRECISION_X, PRECISION_Y, red, green, blue) as (parts, 1, K, 6), or
    (shares, B, K, 6) where each frame has its own slices. The caller sums over the first axis.
    """
    batch, count = len(spots), slices.shape[1]
    height, width = grad.shape[2:]
    number = tiles.count_tiles(height, width)
    shares = min(number, (FEWEST_TASKS + batch - 1) // max(batch, 1))
    tasks = batch * shares
    parts = min(PARTS, tasks)
    single = len(slices) == 1
    # Each part clears its own just before use: memory that is cleared elsewhere has left the cache by then.
    spot_grad = np.empty((shares, batch, count, 3), np.float32)
    shared_grad = np.empty((parts if single else shares, len(slices), count, 6), np.float32)
    for index in prange(parts):
        part = np.int64(index)
        first, end = part * tasks // parts, (part + 1) * tasks // parts
        for task in range(first, end):
            frame, share = task // shares, task % shares
            own = frame % len(slices)
            into = shared_grad[part if single else share, own]
            if task == first or not single:
                into[:] = ZERO
            spot_grad[share, frame] = ZERO
            for at in range(share, number, shares):
                window = tiles.place(at, height, width)
                tile = fill(state[frame], grad[frame], background, window)
                undraw(spot_grad[share, frame], into, tile, spots[frame], slices[own], color[own], window)
    return spot_grad, shared_grad


@compiled()
def fill(state, grad, background, window):
    """Restore a tile as the forward kernel left it, with the loss gradient of its pixels."""
    top, left, rows, columns = window
    tile = np.zeros(tiles.LINES * STRIDE, np.float32)
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
            tile[at + BEHIND] = background[0] * red + background[1] * green + background[2] * blue
    return tile


@compiled()
def undraw(spot_grad, shared_grad, tile, spots, slices, color, window):
    """Remove the spots (6, K) of a frame from one of its tiles and add to both gradients."""
    reals, integers = runs.new_list()
    found = 0
    for group in range(spots.shape[1] - WIDTH, -1, -WIDTH):
        met = tiles.meeting(spots, group, window)
        while met:
            lane = 63 - leading_zeros(met)
            runs.gather(reals, integers, found, spots, slices, color, group + lane)
            found += 1
            met ^= 1 << lane
        if found >= runs.FULL:
            undraw_listed(spot_grad, shared_grad, tile, reals, integers, found, window)
            found = 0
    undraw_listed(spot_grad, shared_grad, tile, reals, integers, found, window)


@compiled()
def undraw_listed(spot_grad, shared_grad, tile, reals, integers, found, window):
    """Remove the ``found`` spots of a list."""
    for group in range(0, found, WIDTH):
        longest = runs.cross(reals, integers, group, window, STRIDE)
        for lane in range(min(WIDTH, found - group)):
            undraw_spot(spot_grad, shared_grad, tile, reals, integers, group + lane, lane, longest)


@compiled(inside=True)
def undraw_spot(spot_grad, shared_grad, tile, reals, integers, spot, lane, longest):
    """Remove one spot of a list, in a lane of its crossing."""
    k = integers[spot + runs.OWNER]
    index = np.float32(k)
    own_red, own_green, own_blue = reals[spot + runs.RED], reals[spot + runs.GREEN], reals[spot + runs.BLUE]
    scale = reals[lane + runs.SCALE]
    # Moments of dL/dsigma over the pixels: u is the scaled distance from the axis, h the height above the
    # centre.
    g = g_u = g_h = g_uu = g_uh = g_hh = splat(ZERO)
    to_red = to_green = to_blue = splat(ZERO)
    for run in range(longest):
        steps = (ramp() + np.float32(run * RUN)) * scale
        here = run * WIDTH + lane
        for row in range(integers[here + runs.FIRST], integers[here + runs.LAST], runs.AT_ONCE):
            u = steps + runs.look_up(reals, runs.OFFSET, row, lane)
            h = runs.look_up(reals, runs.HEIGHT, row, lane)
            t = runs.look_up(reals, runs.PEAK, row, lane) - u * u
            at = runs.find_places(integers, run, row, lane)
            red, green, blue = load_at(tile, at, RED), load_at(tile, at, GREEN), load_at(tile, at, BLUE)
            loss = load_at(tile, at, BEHIND) - own_red * red - own_green * green - own_blue * blue
            pull, weight = unblend(tile, at, t, index, loss)
            to_red = to_red + weight * red
            to_green = to_green + weight * green
            to_blue = to_blue + weight * blue
            pull_u, pull_h = pull * u, pull * h
            g, g_u, g_h = g + pull, g_u + pull_u, g_h + pull_h
            g_uu, g_uh, g_hh = g_uu + pull_u * u, g_uh + pull_u * h, g_hh + pull_h * h
    store_sums(reals, runs.SUMS, g_uh, g_uu, g_hh, to_red, to_green, to_blue, g_u, g_h)
    # The scale is the root of an eighth of PRECISION_X.
    pull_x = SIXTEEN * scale * reals[runs.SUMS + 6]
    pull_y = TWO * reals[spot + runs.PRECISION_Y] * reals[runs.SUMS + 7]
    spot_grad[k, 0] -= pull_x
    spot_grad[k, 1] += reals[spot + runs.SLOPE] * pull_x - pull_y
    spot_grad[k, 2] -= sum_lanes(g) / reals[spot + runs.OPACITY]
    shared_grad[k, 0] -= SIXTEEN * scale * reals[runs.SUMS]
    shared_grad[k, 1] += reals[runs.SUMS + 1] / scale / scale
    for column in range(2, 6):
        shared_grad[k, column] += reals[runs.SUMS + column]


@compiled()
def load_at(tile, at, strip):
    """What a strip of a tile holds in the runs at ``at``."""
    return load_runs(tile, at[0] + strip, at[1] + strip)


@compiled(inside=True)
def unblend(tile, at, t, index, loss):
    """Remove one Gaussian from the runs of pixels at ``at``; return dL/dsigma and its weight in each."""
    covered = runs.alpha_at(t)
    live = (splat(ZERO) <= t) & (index < load_at(tile, at, STOP))
    alpha = select(live, minimum(covered, splat(ALPHA_MAX)), splat(ZERO))
    before = load_at(tile, at, 0) / (1.0 - alpha)
    weight = alpha * before
    store_runs(tile, at[0], at[1], before)
    store_runs(tile, at[0] + BEHIND, at[1] + BEHIND, load_at(tile, at, BEHIND) - alpha * loss)
    # The clamp has no gradient, nor have pixels far outside, where `covered` is arbitrary but alpha is 0.
    return select(covered < ALPHA_MAX, weight * loss, splat(ZERO)), weight
