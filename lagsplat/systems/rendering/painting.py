"""Render simulated systems: a shaded soft arm before a board, and flat bodies before a wall.

Each sample of an arm's pixel is mapped to arc length ``s`` and lateral offset ``n`` [m] of each part, so that
shading follows the deformation. A part's edge is a linear ramp one sample wide, so that the image is
continuous in the state at any resolution. A rigid body is a sprite parallel to the plane of motion, or, if it
is thick, a stack of them from back to front, so that a camera from the side sees its flank.
"""

from dataclasses import dataclass
from typing import no_type_check

import cv2
import numpy as np
from jaxtyping import Float32, Float64
from numba import njit

from lagsplat.systems.arm import Arm
from lagsplat.systems.chain import LENGTH, LINK_LENGTH
from lagsplat.systems.config import SceneConfig, SimulationConfig
from lagsplat.systems.rendering.textures import Sprite
from lagsplat.views.camera import Camera, Homography

SAMPLES = 4
TOP = 0.07
RINGS = 3.0
SEGMENT_COLORS = ((0.93, 0.52, 0.20), (0.22, 0.62, 0.72))
CONNECTOR_COLOR = (0.20, 0.20, 0.24)
CAP_COLOR = (0.90, 0.86, 0.78)
CLAMP_COLOR = (0.30, 0.31, 0.35)
LIGHT_DOWN, LIGHT_RIGHT, LIGHT_OUT = -0.35, -0.45, 0.80

Image = Float32[np.ndarray, "H W 3"]


def paint_board(config: SimulationConfig, *, generator: np.random.Generator) -> Image:
    """The static background in [0, 1]: a softly lit, mottled board and the clamp of the arm.

    One seed gives the same board at every resolution.
    """
    count, fine, height, width = 40, 8, config.height, config.width
    direction = generator.uniform(0, 2 * np.pi, count)
    wave = 2 * np.pi * generator.uniform(3, 12, count)
    phase = generator.uniform(0, 2 * np.pi, count)
    tint = generator.uniform(0.6, 1.4, (count, 3)) / np.sqrt(count)
    x = (np.arange(width * fine) + 0.5) / (width * fine)
    y = (np.arange(height * fine) + 0.5) / (width * fine)
    across = np.exp(1j * (wave * np.cos(direction) * x[:, None] + phase))
    down = np.exp(1j * wave * np.sin(direction) * y[:, None])
    board = np.stack([((down * shade) @ across.T).imag for shade in tint.T], axis=-1)
    light = 0.60 - 0.16 * x[None, :] - 0.10 * y[:, None]
    board = light[..., None] * np.array([0.92, 1.0, 0.90]) * (1 + 0.13 * board)
    arm_share = config.arm.half_width / config.view_width
    clamp = (y[:, None] < TOP) & (np.abs(x[None, :] - 0.5) < 0.75 * arm_share)
    board[clamp] = np.array(CLAMP_COLOR)
    pixels = board.reshape(height, fine, width, fine, 3).mean(axis=(1, 3))
    return np.clip(pixels, 0.0, 1.0).astype(np.float32)


@njit(cache=True)
@no_type_check
def _material(down, right, part, widest):
    """Arc length and lateral offset of a point in the frame of a part, smooth through zero curvature.

    Points further out than ``widest`` get the arc length minus infinity.
    """
    dx, dy = down - part[0], right - part[1]
    along, across = dx * part[2] + dy * part[3], dy * part[2] - dx * part[3]
    curvature = part[4]
    real, imag = 1 - curvature * across, curvature * along
    offset = (2 * across - curvature * (along**2 + across**2)) / (1 + np.sqrt(real**2 + imag**2))
    if abs(offset) > widest:
        return -np.inf, offset
    if abs(curvature) < 1e-9:
        return along, offset
    return np.arctan2(imag, real) / curvature, offset


@njit(cache=True)
@no_type_check
def _lay_out(q, table, parts):
    """Fill ``parts``: base (down, right), direction (cos, sin), curvature, length; segments, then links."""
    n = table.shape[0]
    down, right, angle = 0.0, 0.0, 0.0
    for i in range(n):
        length = table[i, LENGTH] * (1 + q[2 * i + 1])
        parts[i] = np.array((down, right, np.cos(angle), np.sin(angle), q[2 * i] / length, length))
        half = 0.5 * q[2 * i]
        chord = length * (np.sin(half) / half if abs(half) > 1e-8 else 1.0)
        down += chord * np.cos(angle + half)
        right += chord * np.sin(angle + half)
        angle += q[2 * i]
        link = table[i, LINK_LENGTH]
        parts[n + i] = np.array((down, right, np.cos(angle), np.sin(angle), 0.0, link))
        down += link * np.cos(angle)
        right += link * np.sin(angle)


@njit(cache=True)
@no_type_check
def _shade(arc_length, offset, part, half_width, rings):
    """Brightness of a lit round arm whose reinforcing rings stretch with it."""
    across = min(max(offset / half_width, -1.0), 1.0)
    turn = part[4] * arc_length
    cosine = part[2] * np.cos(turn) - part[3] * np.sin(turn)
    sine = part[3] * np.cos(turn) + part[2] * np.sin(turn)
    facing = across * (cosine * LIGHT_RIGHT - sine * LIGHT_DOWN) + (1 - 0.7 * across**2) * LIGHT_OUT
    ring = 1 - 0.16 * np.cos(2 * np.pi * rings * arc_length / part[5])
    return (0.35 + 0.75 * max(facing, 0.0)) * ring


@njit(cache=True)
@no_type_check
def _blend_parts(down, right, parts, near, n_near, half_width, step, colors, color):
    """Blend the near parts over ``color`` at one point, the segments first."""
    n_segments = len(parts) // 2
    for i in range(n_near):
        k = near[i]
        link = k >= n_segments
        wide = 1.12 * half_width if link else half_width
        over = 0.1 * half_width if link else 0.0
        s, n = _material(down, right, parts[k], wide + step)
        if s < -over - step or s > parts[k, 5] + over + step:
            continue
        cover = min(max(0.5 + (wide - abs(n)) / step, 0.0), 1.0)
        cover *= min(max(0.5 + (s + over) / step, 0.0), 1.0)
        cover *= min(max(0.5 + (parts[k, 5] + over - s) / step, 0.0), 1.0)
        light = _shade(s, n, parts[k], wide, 0.0 if link else RINGS)
        for c in range(3):
            color[c] += cover * (min(light * colors[k, c], 1.0) - color[c])


@njit(cache=True)
@no_type_check
def _paint(states, table, half_width, board, colors, view_width, images):
    frames, height, width, _ = images.shape
    n_parts = 2 * table.shape[0]
    pixel = view_width / width
    step = pixel / SAMPLES
    reach = 1.3 * half_width + 2 * pixel
    parts = np.zeros((n_parts, 6))
    near = np.zeros(n_parts, np.int64)
    color, total = np.zeros(3), np.zeros(3)
    for t in range(frames):
        _lay_out(states[t], table, parts)
        images[t] = board
        for row in range(height):
            for column in range(width):
                top, left = row * pixel - TOP * view_width, column * pixel - 0.5 * view_width
                n_near = 0
                for k in range(n_parts):
                    s = _material(top + 0.5 * pixel, left + 0.5 * pixel, parts[k], reach)[0]
                    if -reach < s < parts[k, 5] + reach:
                        near[n_near] = k
                        n_near += 1
                if n_near == 0:
                    continue
                total[:] = 0.0
                for a in range(SAMPLES * SAMPLES):
                    down, right = top + (a // SAMPLES + 0.5) * step, left + (a % SAMPLES + 0.5) * step
                    color[:] = board[row, column]
                    _blend_parts(down, right, parts, near, n_near, half_width, step, colors, color)
                    total += color
                for c in range(3):
                    images[t, row, column, c] = total[c] / (SAMPLES * SAMPLES)


def paint_arm(
    arm: Arm, states: Float64[np.ndarray, "T d"], config: SimulationConfig, board: Image
) -> Float32[np.ndarray, "T H W 3"]:
    """Noise-free images in [0, 1] of the arm in these states, at the board's resolution."""
    n = states.shape[1] // 2
    segments = [SEGMENT_COLORS[i % len(SEGMENT_COLORS)] for i in range(n)]
    colors = np.array([*segments, *[CONNECTOR_COLOR] * (n - 1), CAP_COLOR])
    images = np.empty((len(states), *board.shape), np.float32)
    half_width, view_width = config.arm.half_width, config.view_width
    _paint(np.ascontiguousarray(states), arm.table, half_width, board, colors, view_width, images)
    return images


FLANK = 0.72  # brightness of a stack's inner layers, which only its flank shows


@dataclass(frozen=True)
class DrawnBody:
    """A sprite and its thickness [m]; ``layers`` sprites make a stack, a single one has no thickness."""

    sprite: Sprite
    thickness: float
    layers: int


def paint_backdrop(wall: Image, camera: Camera, scene: SceneConfig) -> Image:
    """The wall from a camera, around the scene's target, behind the plane of motion."""
    rows, columns = wall.shape[:2]
    size = scene.background_width / columns
    right, down = size * np.eye(3)[0], size * np.eye(3)[1]
    x, y = scene.target
    corner = np.array([x - 0.5 * scene.background_width, y - 0.5 * size * rows, scene.behind])
    map_ = camera.of_plane(corner, right, down)
    return _warp(wall, map_, (0, 0, camera.width, camera.height), cv2.BORDER_REFLECT_101)


def paint_bodies(
    background: Image, bodies: list[DrawnBody], poses: Float64[np.ndarray, "n_bodies 3"], camera: Camera
) -> Image:
    """Bodies in their poses over the background, in [0, 1]; later bodies over earlier ones."""
    image = background.copy()
    for body, (x, y, angle) in zip(bodies, poses, strict=True):
        right = np.array([np.cos(angle), np.sin(angle), 0.0]) / body.sprite.scale
        down = np.array([-np.sin(angle), np.cos(angle), 0.0]) / body.sprite.scale
        left_px, top_px = body.sprite.origin
        for layer in range(body.layers):
            depth = body.thickness * (0.5 - (layer + 1) / body.layers) if body.layers > 1 else 0.0
            corner = np.array([x, y, depth]) - left_px * right - top_px * down
            map_ = camera.of_plane(corner, right, down)
            light = 1.0 if layer == body.layers - 1 else FLANK
            _blend_sprite(image, body.sprite.rgba, map_, light)
    return image


def _blend_sprite(image: Image, rgba: np.ndarray, map_: Homography, light: float) -> None:
    """Blend a sprite into ``image``, in place, within the rectangle that it can reach."""
    height, width = image.shape[:2]
    rows, columns = rgba.shape[:2]
    corners = np.array([[0, 0, 1], [columns, 0, 1], [0, rows, 1], [columns, rows, 1]]) @ map_.T
    reached = corners[:, :2] / corners[:, 2:]
    left, top = np.clip(np.floor(reached.min(axis=0)) - 1, 0, [width, height]).astype(int)
    right, bottom = np.clip(np.ceil(reached.max(axis=0)) + 1, 0, [width, height]).astype(int)
    if left >= right or top >= bottom:
        return
    seen = _warp(rgba, map_, (left, top, right, bottom), cv2.BORDER_CONSTANT)
    part = image[top:bottom, left:right]
    part[:] = part * (1 - seen[:, :, 3:]) + light * seen[:, :, :3]


def _warp(image: np.ndarray, map_: Homography, box: tuple[int, int, int, int], border: int) -> np.ndarray:
    """The part of a plane's image inside ``box``: left, top, right, bottom [pixel]."""
    left, top, right, bottom = box
    # OpenCV counts pixel centres from 0, the camera from 0.5.
    to_centers = np.array([[1, 0, -0.5 - left], [0, 1, -0.5 - top], [0, 0, 1.0]])
    from_centers = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    turned = to_centers @ map_ @ from_centers
    return cv2.warpPerspective(
        image, turned, (right - left, bottom - top), flags=cv2.INTER_LINEAR, borderMode=border
    )


def add_camera_noise(clean: np.ndarray, noise_levels: float, generator: np.random.Generator) -> np.ndarray:
    """Grey levels of images in [0, 1] with noise of the standard deviation ``noise_levels`` [of 255]."""
    noise = generator.standard_normal(clean.shape, dtype=np.float32)
    return round_to_levels(255 * clean + np.float32(noise_levels) * noise)


def round_to_levels(image: np.ndarray) -> np.ndarray:
    """The image as uint8."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
