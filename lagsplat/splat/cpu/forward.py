# mypy: ignore-errors
# (Numba infers the types of kernels.)
"""Forward kernel: blend each Gaussian, front to back, into the pixels it covers."""

import numpy as np
from numba import prange

from lagsplat.splat.cpu import runs, tiles
from lagsplat.splat.cpu.simd import (
    RUN,
    WIDTH,
    compiled,
    load_runs,
    minimum,
    ramp,
    select,
    splat,
    store_runs,
    to_bits,
    trailing_zeros,
)
from lagsplat.splat.cpu.tiles import BLUE, GREEN, RED, STOP, ZERO
from lagsplat.splat.image_model import ALPHA_MAX, TRANSMITTANCE_MIN

LAST, STRIDE = 5 * tiles.PITCH, 6 * tiles.PITCH


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
                stop = tile[at + STOP]
                passed = tile[at] if stop == count else tile[at + LAST]
                state[frame, 0, y, x] = passed
                state[frame, 1, y, x] = stop
                images[frame, 0, y, x] = tile[at + RED] + passed * background[0]
                images[frame, 1, y, x] = tile[at + GREEN] + passed * background[1]
                images[frame, 2, y, x] = tile[at + BLUE] + passed * background[2]
    return images, state


@compiled()
def blank(columns, count):
    """An empty tile for ``count`` Gaussians; only its first ``columns`` columns are drawn.

    Pixels that take no more light have a transmittance of NaN, which no comparison lets pass.
    """
    tile = np.zeros(tiles.LINES * STRIDE, np.float32)
    for row in range(tiles.LINES):
        drawn = columns if row < tiles.ROWS else 0
        for column in range(tiles.PITCH):
            tile[row * STRIDE + column] = tiles.ONE if column < drawn else np.float32(np.nan)
            tile[row * STRIDE + STOP + column] = np.float32(count)
    return tile


@compiled()
def draw(tile, spots, slices, color, window):
    """Draw the spots (6, K) of a frame into one of its tiles."""
    reals, integers = runs.new_list()
    found = 0
    for group in range(0, spots.shape[1], WIDTH):
        met = tiles.meeting(spots, group, window)
        while met:
            runs.gather(reals, integers, found, spots, slices, color, group + trailing_zeros(met))
            found += 1
            met &= met - 1
        if found >= runs.FULL:
            draw_listed(tile, reals, integers, found, window)
            found = 0
    draw_listed(tile, reals, integers, found, window)


@compiled()
def draw_listed(tile, reals, integers, found, window):
    """Draw the ``found`` spots of a list."""
    for group in range(0, found, WIDTH):
        longest = runs.cross(reals, integers, group, window, STRIDE)
        for lane in range(min(WIDTH, found - group)):
            draw_spot(tile, reals, integers, group + lane, lane, longest)


@compiled(inside=True)
def draw_spot(tile, reals, integers, spot, lane, longest):
    """Draw one spot of a list, in a lane of its crossing."""
    index = np.float32(integers[spot + runs.OWNER])
    rgb = reals[spot + runs.RED], reals[spot + runs.GREEN], reals[spot + runs.BLUE]
    scale = reals[lane + runs.SCALE]
    for run in range(longest):
        steps = (ramp() + np.float32(run * RUN)) * scale
        here = run * WIDTH + lane
        for row in range(integers[here + runs.FIRST], integers[here + runs.LAST], runs.AT_ONCE):
            u = steps + runs.look_up(reals, runs.OFFSET, row, lane)
            t = runs.look_up(reals, runs.PEAK, row, lane) - u * u
            blend(tile, runs.find_places(integers, run, row, lane), t, index, rgb)


@compiled(inside=True)
def blend(tile, at, t, index, rgb):
    """Blend one Gaussian into the runs of pixels at ``at``."""
    first, second = at
    before = load_runs(tile, first, second)
    light = minimum(runs.alpha_at(t), splat(ALPHA_MAX)) * before
    after = before - light
    covered = splat(ZERO) <= t
    passed = covered & (after > TRANSMITTANCE_MIN)
    weight = select(passed, light, splat(ZERO))
    store_runs(tile, first, second, select(passed, after, before))
    for strip, part in ((RED, rgb[0]), (GREEN, rgb[1]), (BLUE, rgb[2])):
        shown = load_runs(tile, first + strip, second + strip) + weight * part
        store_runs(tile, first + strip, second + strip, shown)
    finished = covered & (after <= TRANSMITTANCE_MIN)
    if to_bits(finished):
        finish(tile, first, second, finished, before, index)


@compiled()
def finish(tile, first, second, finished, passed, index):
    """Let pixels take no more light, and keep what has passed them and which Gaussian finished them."""
    now = load_runs(tile, first, second)
    store_runs(tile, first, second, select(finished, splat(np.float32(np.nan)), now))
    now = load_runs(tile, first + LAST, second + LAST)
    store_runs(tile, first + LAST, second + LAST, select(finished, passed, now))
    now = load_runs(tile, first + STOP, second + STOP)
    store_runs(tile, first + STOP, second + STOP, select(finished, splat(index), now))
