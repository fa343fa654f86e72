"""Walls of a workshop, drawn by formula: what simulated mechanisms are filmed in front of.

Lengths are in units of one; a wall is twelve wide and eight high, whatever its width in metres.
"""

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float32

from lagsplat.systems.rendering.textures import Color, Drawing, Sprite

WIDE, HIGH = 12.0, 8.0
PIXELS = 75.0  # per unit
STEEL, RUBBER = (0.55, 0.57, 0.60), (0.22, 0.22, 0.24)
PAINTS = ((0.62, 0.30, 0.24), (0.28, 0.42, 0.52), (0.72, 0.62, 0.36), (0.36, 0.46, 0.34), (0.50, 0.48, 0.46))


@cache
def draw_wall(name: str) -> Float32[np.ndarray, "h w 3"]:
    """A wall by its name, colours in [0, 1]; the same at every call, and not to be written to.

    Raises:
        ValueError: there is no such wall.
    """
    if name not in WALLS:
        raise ValueError(f"no wall {name!r}; choose one of {', '.join(sorted(WALLS))}")
    wall = np.ascontiguousarray(WALLS[name](np.random.default_rng(0)).rgba[:, :, :3])
    wall.setflags(write=False)
    return wall


def _start(color: Color) -> Drawing:
    drawing = Drawing((0.0, 0.0, WIDE, HIGH), unit_m=1.0, scale=PIXELS)
    _box(drawing, 0.0, 0.0, WIDE, HIGH, color)
    return drawing


def _box(drawing: Drawing, left: float, top: float, width: float, height: float, color: Color) -> None:
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    drawing.polygon(corners + np.array([left, top]), color)


def _shade(color: Color, by: float) -> Color:
    red, green, blue = (min(max(part * by, 0.0), 1.0) for part in color)
    return red, green, blue


def _draw_pegboard(generator: np.random.Generator) -> Sprite:
    """A perforated board with tools on it."""
    drawing = _start((0.70, 0.69, 0.65))
    for x in np.arange(0.25, WIDE, 0.5):
        for y in np.arange(0.25, HIGH, 0.5):
            drawing.ring((x, y), 0.0, 0.06, (0.36, 0.35, 0.33))
    for x, long in ((1.2, 2.6), (2.0, 2.2), (2.8, 1.9)):  # screwdrivers
        drawing.line((x, 0.9), (x, 1.7), 0.34, PAINTS[generator.integers(len(PAINTS))])
        drawing.line((x, 1.7), (x, 0.9 + long), 0.10, STEEL)
    for x, size in ((9.2, 0.9), (10.0, 1.1), (10.9, 1.3)):  # spanners
        drawing.line((x, 1.0), (x, 1.0 + 2.2 * size), 0.2 * size, STEEL)
        drawing.ring((x, 1.0), 0.15 * size, 0.34 * size, STEEL)
        drawing.ring((x, 1.0 + 2.2 * size), 0.12 * size, 0.28 * size, STEEL)
    drawing.line((4.6, 1.0), (4.6, 3.6), 0.22, (0.66, 0.50, 0.30))  # a hammer
    drawing.line((4.1, 1.0), (5.1, 1.0), 0.42, RUBBER)
    drawing.line((6.9, 1.2), (6.5, 3.2), 0.24, PAINTS[0])  # pliers
    drawing.line((7.1, 1.2), (7.5, 3.2), 0.24, PAINTS[0])
    drawing.line((6.9, 1.4), (7.05, 0.7), 0.2, RUBBER)
    drawing.line((7.1, 1.4), (6.95, 0.7), 0.2, RUBBER)
    drawing.ring((2.0, 5.9), 0.75, 1.05, PAINTS[1])  # a coil of cable
    drawing.ring((2.0, 5.9), 0.50, 0.68, PAINTS[1])
    drawing.ring((10.2, 6.2), 0.5, 0.85, (0.78, 0.72, 0.52))  # a roll of tape
    _box(drawing, 4.2, 6.3, 3.4, 0.28, (0.74, 0.64, 0.34))  # a rule
    for x in np.arange(4.3, 7.6, 0.2):
        drawing.line((x, 6.34), (x, 6.46), 0.025, RUBBER)
    return drawing.finish(texture="speckle", contrast=0.03)


def _draw_shelves(generator: np.random.Generator) -> Sprite:
    """Two shelves with tins, boxes and jars before a plastered wall."""
    drawing = _start((0.72, 0.72, 0.68))
    for floor in (2.6, 5.3, 7.8):
        x = 0.2
        while x < WIDE - 1.0:
            wide, high = generator.uniform(0.5, 1.3), generator.uniform(0.8, 1.9)
            color = _shade(PAINTS[generator.integers(len(PAINTS))], generator.uniform(0.85, 1.2))
            _box(drawing, x, floor - high, wide, high, color)
            _box(drawing, x, floor - 0.75 * high, wide, 0.35 * high, _shade(color, 1.15))  # its label
            _box(drawing, x + 0.06, floor - high, 0.08, high, _shade(color, 1.2))
            x += wide + generator.uniform(0.05, 0.6)
        _box(drawing, 0.0, floor, WIDE, 0.18, (0.58, 0.46, 0.32))
        _box(drawing, 0.0, floor + 0.18, WIDE, 0.10, (0.50, 0.49, 0.47))  # the shelf's shadow
    return drawing.finish(texture="speckle", contrast=0.05)


def _draw_planks(generator: np.random.Generator) -> Sprite:
    """Upright boards with knots and nails."""
    drawing = _start((0.30, 0.24, 0.18))
    edges = np.append(np.arange(0.0, WIDE, 1.0) + generator.uniform(-0.12, 0.12, 12), WIDE)
    for left, right in pairwise(edges):
        color = _shade((0.66, 0.54, 0.40), generator.uniform(0.85, 1.12))
        _box(drawing, left, 0.0, right - left - 0.05, HIGH, color)
        middle = 0.5 * (left + right)
        for y in generator.uniform(0.8, HIGH - 0.8, generator.integers(1, 4)):
            knot = (middle + generator.uniform(-0.15, 0.15), y)
            drawing.ring(knot, 0.0, 0.11, _shade(color, 0.6))
            drawing.ring(knot, 0.16, 0.20, _shade(color, 0.8))
        for y in (0.35, HIGH - 0.35):
            drawing.ring((middle, y), 0.0, 0.06, RUBBER)
    return drawing.finish(texture="wood", contrast=0.09)


def _draw_bricks(generator: np.random.Generator) -> Sprite:
    """A limewashed wall of bricks in running bond."""
    drawing = _start((0.80, 0.79, 0.76))
    long, high, joint = 1.5, 0.5, 0.07
    for row, y in enumerate(np.arange(0.0, HIGH, high)):
        for x in np.arange(-long if row % 2 else -0.5 * long, WIDE, long):
            color = _shade((0.68, 0.66, 0.61), generator.uniform(0.88, 1.1))
            _box(drawing, x, y, long - joint, high - joint, color)
    return drawing.finish(texture="speckle", contrast=0.08)


WALLS: dict[str, Callable[[np.random.Generator], Sprite]] = {
    "bricks": _draw_bricks,
    "pegboard": _draw_pegboard,
    "planks": _draw_planks,
    "shelves": _draw_shelves,
}
