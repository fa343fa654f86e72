"""Textured flat bodies: images with coverage, drawn once and moved by `painting`.

Every body has its own coordinates [m], x to the right and y down, with its hinge, or its runner's centre, at
the origin. Surfaces have a grain of noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Float32

OVERSAMPLING = 4
GRAINS = {"speckle": (24, 24), "wood": (6, 90)}  # patches of the coarsest noise down and across
RAINBOW = ((0.80, 0.16, 0.15), (0.93, 0.55, 0.12), (0.95, 0.83, 0.22), (0.22, 0.60, 0.30), (0.16, 0.36, 0.66))
Color = tuple[float, float, float]
Point = tuple[float, float]


@dataclass(frozen=True)
class Sprite:
    """The image of a flat body."""

    rgba: Float32[np.ndarray, "h w 4"]  # colours times coverage, and coverage, in [0, 1]
    origin: Point  # the body's origin in the image [px]
    scale: float  # pixels per metre


def make_grain(name: str, shape: tuple[int, int]) -> Float32[np.ndarray, "h w"]:
    """Noise of zero mean and unit deviation for a surface: octaves of half the size and 0.7 of the height."""
    generator, size = np.random.default_rng(0), shape[1::-1]
    grain = np.zeros(shape, np.float32)
    for octave in range(4):
        rows, columns = (patches << octave for patches in GRAINS[name])
        noise = generator.standard_normal((rows, columns), np.float32)
        grain += 0.7**octave * cv2.resize(noise, size, interpolation=cv2.INTER_CUBIC)
    return (grain - grain.mean()) / np.float32(grain.std())


class Drawing:
    """A canvas for a body made of plain shapes, later ones over earlier ones.

    Lengths are in units of ``unit_m`` [m]; ``reach`` is the canvas's (left, top, right, bottom).
    """

    def __init__(self, reach: tuple[float, float, float, float], *, unit_m: float, scale: float) -> None:
        left, top, right, bottom = reach
        self.scale, self.per_unit = scale, unit_m * scale
        self.fine = self.per_unit * OVERSAMPLING
        self.corner = np.array([left, top])
        height, width = (round(side * self.per_unit) * OVERSAMPLING for side in (bottom - top, right - left))
        self.color = np.zeros((height, width, 3), np.float32)
        self.cover = np.zeros((height, width), np.float32)

    def polygon(self, points: np.ndarray, color: Color) -> None:
        """Draw a filled polygon."""
        corners = np.round((points - self.corner) * self.fine).astype(np.int32)
        part, first = self._part(corners.min(axis=0), corners.max(axis=0) + 1)
        mask = np.zeros(self.cover[part].shape, np.uint8)
        cv2.fillPoly(mask, [corners - first], 255)
        self._fill(part, mask > 0, color)

    def line(self, start: Point, stop: Point, width: float, color: Color) -> None:
        """Draw a straight bar with round ends."""
        ends = np.array([start, stop])
        along = ends[1] - ends[0]
        side = 0.5 * width * np.array([-along[1], along[0]]) / np.hypot(*along)
        self.polygon(np.array([ends[0] + side, ends[1] + side, ends[1] - side, ends[0] - side]), color)
        for end in ends:
            self.ring(tuple(end), 0.0, 0.5 * width, color)

    def ring(
        self, middle: Point, inner: float, outer: float, color: Color, *, lower_half: bool = False
    ) -> None:
        """Draw an annulus, or only its lower half."""
        center = (np.array(middle) - self.corner) * self.fine
        part, first = self._part(np.floor(center - outer * self.fine), np.ceil(center + outer * self.fine))
        rows, columns = np.indices(self.cover[part].shape, dtype=np.float32)
        x = (columns + first[0] + 0.5) / self.fine + self.corner[0] - middle[0]
        y = (rows + first[1] + 0.5) / self.fine + self.corner[1] - middle[1]
        distance = np.hypot(x, y)
        inside = (distance >= inner) & (distance <= outer)
        self._fill(part, inside & (y >= 0) if lower_half else inside, color)

    def _part(self, first: np.ndarray, last: np.ndarray) -> tuple[tuple[slice, slice], np.ndarray]:
        """The rows and columns of the canvas between two corners (x, y), and the first of them."""
        (left, top), (right, bottom) = np.clip([first, last], 0, self.cover.shape[::-1]).astype(int)
        return (slice(top, bottom), slice(left, right)), np.array([left, top], np.int32)

    def _fill(self, part: tuple[slice, slice], where: np.ndarray, color: Color) -> None:
        self.color[part][where] = color
        self.cover[part][where] = 1.0

    def finish(self, *, texture: str | None, contrast: float) -> Sprite:
        """The sprite, its colours modulated by a grain of this contrast."""
        color: Float32[np.ndarray, "h w 3"] = self.color
        if texture is not None:
            color = color * (1 + contrast * make_grain(texture, self.cover.shape))[:, :, None]
        rgba = np.dstack([np.clip(color, 0, 1) * self.cover[:, :, None], self.cover])
        size = (rgba.shape[1] // OVERSAMPLING, rgba.shape[0] // OVERSAMPLING)
        small = cv2.resize(rgba, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        left, top = -self.corner * self.per_unit
        return Sprite(small, (float(left), float(top)), self.scale)


def bob(size_m: list[float], scale: float) -> Sprite:
    """A rod of length ``size_m[0]`` with a ball of radius ``size_m[1]`` at its end."""
    rod = size_m[0] / size_m[1]
    drawing = Drawing((-1.3, -1.0, 1.3, rod + 1.3), unit_m=size_m[1], scale=scale)
    drawing.line((0.0, 0.0), (0.0, rod), 0.22, (0.75, 0.74, 0.72))
    drawing.ring((0.0, rod), 0.0, 1.0, (0.75, 0.22, 0.16))
    drawing.ring((0.25, rod - 0.25), 0.0, 0.35, (0.92, 0.62, 0.40))
    return drawing.finish(texture="speckle", contrast=0.06)


def link(size_m: list[float], scale: float) -> Sprite:
    """A bar of length ``size_m[0]`` and width ``size_m[1]`` with a coloured cap at its end."""
    bar = size_m[0] / size_m[1]
    drawing = Drawing((-1.0, -1.0, 1.0, bar + 1.0), unit_m=size_m[1], scale=scale)
    drawing.line((0.0, 0.0), (0.0, bar), 1.0, (0.78, 0.62, 0.36))
    drawing.ring((0.0, 0.0), 0.0, 0.42, (0.15, 0.15, 0.18))
    drawing.ring((0.0, bar), 0.0, 0.75, (0.13, 0.38, 0.66))
    return drawing.finish(texture="wood", contrast=0.05)


def strap(size_m: list[float], scale: float) -> Sprite:
    """A handle of length ``size_m[0]`` and width ``size_m[1]``: two bands."""
    band = size_m[0] / size_m[1]
    drawing = Drawing((-1.0, -0.3, 1.0, band + 0.3), unit_m=size_m[1], scale=scale)
    for side in (-0.35, 0.35):
        drawing.line((0.0, 0.0), (side, band), 0.22, (0.16, 0.16, 0.20))
    return drawing.finish(texture=None, contrast=0.0)


def bag(size_m: list[float], scale: float) -> Sprite:
    """A backpack of width ``size_m[0]`` and height ``size_m[1]``, hung by the middle of its upper edge."""
    wide = size_m[0] / size_m[1]
    drawing = Drawing((-0.6 * wide, -0.06, 0.6 * wide, 1.06), unit_m=size_m[1], scale=scale)
    half = np.array([[0.34, 0.0], [0.5, 0.16], [0.5, 0.9], [0.4, 1.0]]) * [wide, 1.0]
    drawing.polygon(np.concatenate([half, half[::-1] * [-1.0, 1.0]]), (0.20, 0.36, 0.42))
    pocket = np.array([[0.36, 0.52], [0.36, 0.92]]) * [wide, 1.0]
    drawing.polygon(np.concatenate([pocket, pocket[::-1] * [-1.0, 1.0]]), (0.30, 0.50, 0.52))
    drawing.line((-0.34 * wide, 0.57), (0.34 * wide, 0.57), 0.035, (0.9, 0.72, 0.25))
    drawing.line((-0.3 * wide, 0.22), (0.1 * wide, 0.22), 0.03, (0.85, 0.85, 0.82))
    drawing.ring((0.2 * wide, 0.33), 0.0, 0.07, (0.80, 0.30, 0.22))
    return drawing.finish(texture="speckle", contrast=0.10)


def rainbow(size_m: list[float], scale: float) -> Sprite:
    """Half rings from radius ``size_m[0]`` down to ``size_m[1]``, open side up, with a handle."""
    drawing = Drawing((-1.08, -0.45, 1.08, 1.08), unit_m=size_m[0], scale=scale)
    edges = np.linspace(1.0, size_m[1] / size_m[0], len(RAINBOW) + 1)
    for color, (big, small) in zip(RAINBOW, pairwise(edges), strict=True):
        drawing.ring((0.0, 0.0), small, big, color, lower_half=True)
    drawing.line((-0.62, 0.0), (-0.62, -0.3), 0.16, (0.72, 0.55, 0.34))
    return drawing.finish(texture="speckle", contrast=0.05)


def chair(size_m: list[float], scale: float) -> Sprite:
    """A rocking chair from the side, ``size_m[1]`` high, on runners of radius ``size_m[0]``."""
    radius = size_m[0] / size_m[1]
    drawing = Drawing((-0.75, radius - 1.05, 0.75, radius + 0.05), unit_m=size_m[1], scale=scale)
    wood, dark, cloth = (0.62, 0.40, 0.22), (0.45, 0.28, 0.16), (0.70, 0.24, 0.20)
    turns = np.linspace(-0.55, 0.55, 24) / radius
    for start, stop in pairwise(radius * np.stack([np.sin(turns), np.cos(turns)], axis=1)):
        drawing.line(tuple(start), tuple(stop), 0.05, dark)
    ground, seat, back = radius - 0.03, radius - 0.42, radius - 0.98
    drawing.line((-0.25, ground), (-0.28, seat), 0.05, wood)
    drawing.line((0.27, ground), (0.27, seat - 0.2), 0.05, wood)
    drawing.line((-0.28, seat), (0.30, seat - 0.04), 0.08, cloth)
    drawing.line((-0.28, seat), (-0.45, back), 0.06, wood)
    drawing.line((-0.33, seat - 0.2), (0.30, seat - 0.2), 0.05, wood)
    for share in (0.4, 0.7):
        x, y = -0.28 - 0.17 * share, seat + share * (back - seat)
        drawing.line((x, y), (x + 0.08, y + 0.12), 0.035, dark)
    return drawing.finish(texture="wood", contrast=0.05)


SHAPES: dict[str, Callable[[list[float], float], Sprite]] = {
    shape.__name__: shape for shape in (bob, link, strap, bag, rainbow, chair)
}
