"""Films of the mechanisms, 64 by 64 pixels: capsules and discs with smooth edges on a patterned ground.

Every recording has colours, ground and proportions of its own; its nominal and its real films share them.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen.mechanisms import BAG, CART, CHAIN, Mechanism

Array = NDArray[np.float64]
SIDE = 64
# of the pneumatic arms' archives, whose format the films have
FRAME_S = 1001 / 60_000
CHUNK = 64


@dataclass(frozen=True)
class Look:
    """Colours (7, 3) in [0, 1], waves of the ground (4, 3) in 1/px and radians, and thickness as a share."""

    colours: Array
    waves: Array
    thickness: float


@dataclass(frozen=True)
class Camera:
    """Pose of the camera against the nominal one: shift (2,) [px], drift (2,) [px/s], turn [deg], zoom.

    ``exposure_s`` is how long a frame gathers light.
    """

    shift_px: tuple[float, float] = (0.0, 0.0)
    px_per_s: tuple[float, float] = (0.0, 0.0)
    rotation_deg: float = 0.0
    zoom: float = 1.0
    exposure_s: float = 0.0


@dataclass(frozen=True)
class Capsule:
    """All points within ``radius`` pixels of the segments from ``a`` to ``b``, (T, 2) each."""

    a: Array
    b: Array
    radius: float
    colour: int


def draw_look(rng: np.random.Generator) -> Look:
    """Colours that stand off from the ground, and its pattern."""
    colours = rng.uniform(0.05, 0.95, (7, 3))
    colours[0] = rng.uniform(0.6, 0.8, 3)
    for k in range(1, 7):
        # a body is dark or of one strong colour
        colours[k] = rng.uniform(0.0, 0.25, 3)
        colours[k, rng.integers(3)] = rng.uniform(0.5, 0.95) if k > 1 else 0.15
    return Look(colours, rng.uniform(-1.0, 1.0, (4, 3)) * np.array([0.35, 0.35, 3.0]), rng.uniform(0.8, 1.2))


def _hanging(points: Array, look: Look, radius: float) -> list[Capsule]:
    """Links through points (T, n + 1, 2) [px], a disc at every end."""
    links = [Capsule(points[:, k], points[:, k + 1], radius, 1 + k % 3) for k in range(points.shape[1] - 1)]
    ends = [Capsule(points[:, k], points[:, k], 1.7 * radius, 4 + k % 3) for k in range(1, points.shape[1])]
    return [*links, *ends]


def shapes(m: Mechanism, q: Array, look: Look) -> list[Capsule]:
    """What is seen of a mechanism at coordinates (T, d), in pixels from the upper left corner."""
    still = np.zeros(len(q))
    if m.kind == CHAIN:
        lengths = m.p[1 + m.d : 1 + 2 * m.d]
        angle = np.cumsum(q, 1)
        steps = np.stack([np.sin(angle), np.cos(angle)], 2) * (34.0 * lengths / lengths.sum())[:, None]
        points = np.concatenate([np.zeros((len(q), 1, 2)), np.cumsum(steps, 1)], 1) + np.array([32.0, 12.0])
        return _hanging(points, look, (3.0 if m.d == 4 else 2.0) * look.thickness)
    if m.kind == BAG:
        length = 34.0 * (m.p[3] + q[:, 1]) / (m.p[3] + m.size[1])
        end = np.stack([32.0 + length * np.sin(q[:, 0]), 10.0 + length * np.cos(q[:, 0])], 1)
        start = np.broadcast_to(np.array([32.0, 10.0]), end.shape)
        return [Capsule(start, end, 1.0, 1), Capsule(end, end, 6.0 * look.thickness, 5)]
    if m.kind == CART:
        x = 34.0 + 17.0 * q[:, 0] / m.size[0]
        row = still + 34.0
        coils = [
            np.stack([4.0 + (x - 4.0) * share, row - 3.0 * (-1.0) ** k], 1)
            for k, share in enumerate(np.linspace(0.1, 0.75, 6))
        ]
        spring = [Capsule(a, b, 0.8, 1) for a, b in pairwise(coils)]
        body = Capsule(np.stack([x - 4.0, row], 1), np.stack([x + 4.0, row], 1), 4.0 * look.thickness, 4)
        wheels = [
            Capsule(np.stack([x + s, row + 6.0], 1), np.stack([x + s, row + 6.0], 1), 2.0, 2) for s in (-4, 4)
        ]
        return [*spring, body, *wheels]
    radius = 11.0 * look.thickness
    middle = np.stack([32.0 + radius * q[:, 0], still + 50.0 - radius], 1)
    arm = np.stack([-np.sin(q[:, 0]), np.cos(q[:, 0])], 1)
    floor = np.stack([still, still + 50.0], 1)
    return [
        Capsule(floor, floor + np.array([SIDE, 0.0]), 1.0, 1),
        Capsule(middle, middle, radius, 4),
        Capsule(middle - 0.9 * radius * arm, middle + 0.8 * radius * arm, 1.5, 5),
        Capsule(middle - 1.6 * radius * arm, middle - 1.6 * radius * arm, 3.0, 6),
    ]


def _distance(x: Array, y: Array, one: Capsule, rows: slice) -> Array:
    """Distance (n, H, W) of the points from the segments."""
    a, b = one.a[rows], one.b[rows]
    along = b - a
    square = np.maximum((along**2).sum(1), 1e-12)[:, None, None]
    dx, dy = x - a[:, 0, None, None], y - a[:, 1, None, None]
    share = np.clip((dx * along[:, 0, None, None] + dy * along[:, 1, None, None]) / square, 0.0, 1.0)
    return np.hypot(dx - share * along[:, 0, None, None], dy - share * along[:, 1, None, None])


def _picture(m: Mechanism, q: Array, t: Array, look: Look, camera: Camera) -> Array:
    """Sharp frames (n, H, W, 3) in [0, 1]."""
    column, row = np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5)
    middle = 0.5 * SIDE
    # one pose serves all frames unless it drifts
    t = t if any(camera.px_per_s) else t[:1]
    shift = np.array(camera.shift_px) + t[:, None] * np.array(camera.px_per_s)
    dx = column - middle - shift[:, 0, None, None]
    dy = row - middle - shift[:, 1, None, None]
    turn = np.deg2rad(camera.rotation_deg)
    x = middle + (np.cos(turn) * dx + np.sin(turn) * dy) / camera.zoom
    y = middle + (-np.sin(turn) * dx + np.cos(turn) * dy) / camera.zoom
    ground = sum(np.cos(w[0] * x + w[1] * y + w[2]) for w in look.waves) / len(look.waves)
    out = np.clip(look.colours[0] + 0.12 * ground[..., None], 0.0, 1.0)
    out = np.broadcast_to(out, (len(q), *out.shape[1:])).copy()
    for one in shapes(m, q, look):
        cover = np.clip(0.5 + camera.zoom * (one.radius - _distance(x, y, one, slice(None))), 0.0, 1.0)
        out += cover[..., None] * (look.colours[one.colour] - out)
    return out


def film(
    m: Mechanism, q: Array, *, t0: float, look: Look, camera: Camera, noise: float, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Frames (T, 3, H, W) of the motion (T, d), one every ``FRAME_S``, with Gaussian noise ``noise``."""
    n = len(q)
    t = t0 + np.arange(n) * FRAME_S
    parts = np.linspace(0.0, 1.0, 6) if camera.exposure_s > 0.0 else np.zeros(1)
    frames = np.empty((n, 3, SIDE, SIDE), np.uint8)
    for start in range(0, n, CHUNK):
        rows = np.arange(start, min(start + CHUNK, n))
        total = np.zeros((len(rows), SIDE, SIDE, 3))
        for part in parts:
            at = np.clip(rows - part * camera.exposure_s / FRAME_S, 0.0, n - 1.0)
            there = np.stack([np.interp(at, np.arange(n), column) for column in q.T], 1)
            total += _picture(m, there, t[rows], look, camera)
        picture = total / len(parts) + noise * rng.standard_normal(total.shape)
        frames[rows] = np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8).transpose(0, 3, 1, 2)
    return frames
