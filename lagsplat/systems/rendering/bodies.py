"""Pictures of flat bodies before a photograph, through a camera.

A body is a sprite on a plane parallel to the plane of motion; one with a thickness is a pile of them, painted
from the back to the front, so that a camera from the side sees its flank.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from lagsplat.systems.rendering.textures import Sprite
from lagsplat.views.camera import Camera, Homography

Picture = Float32[np.ndarray, "H W 3"]
FLANK = 0.72
"""Brightness of a pile's inner layers, which only its flank shows."""


@dataclass(frozen=True)
class DrawnBody:
    """A sprite and how thick it is [m]; ``layers`` sprites make a pile, one none."""

    sprite: Sprite
    thickness: float
    layers: int


def backdrop(
    photo: Picture, camera: Camera, *, middle: tuple[float, float], behind: float, width: float
) -> Picture:
    """A photograph ``width`` [m] wide around ``middle``, on a wall ``behind`` [m] the plane of motion."""
    rows, columns = photo.shape[:2]
    size = width / columns
    right, down = size * np.eye(3)[0], size * np.eye(3)[1]
    corner = np.array([middle[0] - 0.5 * width, middle[1] - 0.5 * size * rows, behind])
    map_ = camera.of_plane(corner, right, down)
    return _warp(photo, map_, (0, 0, camera.width, camera.height), cv2.BORDER_REFLECT_101)


def paint(
    background: Picture, bodies: list[DrawnBody], poses: Float64[np.ndarray, "n_bodies 3"], camera: Camera
) -> Picture:
    """Bodies in their poses over the background, in [0, 1]; later bodies over earlier ones."""
    picture = background.copy()
    for body, (x, y, angle) in zip(bodies, poses, strict=True):
        right = np.array([np.cos(angle), np.sin(angle), 0.0]) / body.sprite.scale
        down = np.array([-np.sin(angle), np.cos(angle), 0.0]) / body.sprite.scale
        left_px, top_px = body.sprite.origin
        for layer in range(body.layers):
            depth = body.thickness * (0.5 - (layer + 1) / body.layers) if body.layers > 1 else 0.0
            corner = np.array([x, y, depth]) - left_px * right - top_px * down
            map_ = camera.of_plane(corner, right, down)
            light = 1.0 if layer == body.layers - 1 else FLANK
            _blend(picture, body.sprite.rgba, map_, light)
    return picture


def _blend(picture: Picture, rgba: np.ndarray, map_: Homography, light: float) -> None:
    """Lay a sprite over ``picture``, in place, touching only the rectangle it can reach."""
    height, width = picture.shape[:2]
    rows, columns = rgba.shape[:2]
    corners = np.array([[0, 0, 1], [columns, 0, 1], [0, rows, 1], [columns, rows, 1]]) @ map_.T
    reached = corners[:, :2] / corners[:, 2:]
    left, top = np.clip(np.floor(reached.min(axis=0)) - 1, 0, [width, height]).astype(int)
    right, bottom = np.clip(np.ceil(reached.max(axis=0)) + 1, 0, [width, height]).astype(int)
    if left >= right or top >= bottom:
        return
    seen = _warp(rgba, map_, (left, top, right, bottom), cv2.BORDER_CONSTANT)
    part = picture[top:bottom, left:right]
    part[:] = part * (1 - seen[:, :, 3:]) + light * seen[:, :, :3]


def _warp(image: np.ndarray, map_: Homography, box: tuple[int, int, int, int], border: int) -> np.ndarray:
    """What of a plane's image falls into ``box``: left, top, right, bottom [pixel]."""
    left, top, right, bottom = box
    # OpenCV counts pixel centres from 0, the camera from 0.5.
    to_centers = np.array([[1, 0, -0.5 - left], [0, 1, -0.5 - top], [0, 0, 1.0]])
    from_centers = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    turned = to_centers @ map_ @ from_centers
    return cv2.warpPerspective(
        image, turned, (right - left, bottom - top), flags=cv2.INTER_LINEAR, borderMode=border
    )
