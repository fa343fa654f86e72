"""Films of a textured plate that moves in space before a wall, from several cameras."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from lagsplat.matter.scene import MatterScene
from lagsplat.views.camera import Camera, ViewSpace, center_camera, orbit_camera
from lagsplat.views.novel import NovelViews
from tests.unit.matter.films import make_texture

HEIGHT, WIDTH, FOCAL, WALL = 40, 48, 150.0, 190.0
Pose = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Turn about the plate's middle (rotation vector) [rad] and its shift [px] at a state."""


@dataclass(frozen=True)
class Plate:
    """A rectangle at the pivot, tilted about the vertical, and how it moves with the state."""

    pose: Pose
    half: tuple[float, float] = (9.0, 8.0)
    tilt: float = 0.3
    middle: np.ndarray = field(default_factory=lambda: np.array([1.0, -1.0, FOCAL]))

    def carry(self, points: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Where points of the plate at the mean state are at another."""
        turn, shift = self.pose(q)
        return (points - self.middle) @ Rotation.from_rotvec(turn).as_matrix().T + self.middle + shift

    def meet(self, camera: Camera, q: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth at which the rays of pixels meet the plate, infinite if they miss, and material places."""
        turn, shift = self.pose(q)
        axes = Rotation.from_rotvec(turn).as_matrix() @ Rotation.from_rotvec([0, self.tilt, 0]).as_matrix()
        rays = cast(camera, pixels)
        away = self.middle + shift - camera.position
        depth = (away @ axes[:, 2]) / (rays @ axes[:, 2])
        material = (depth[..., None] * rays - away) @ axes[:, :2]
        return np.where((np.abs(material) < self.half).all(-1), depth, np.inf), material

    def meets(self, camera: Camera, points: np.ndarray) -> np.ndarray:
        """Which points a camera sees on the plate at the mean state."""
        return np.isfinite(self.meet(camera, np.zeros(1), camera.project(points))[0])

    def count_pixels(self, camera: Camera) -> int:
        """Pixels that show the plate at the mean state."""
        return int(np.isfinite(self.meet(camera, np.zeros(1), list_places(1))[0]).sum())


TILTED = Plate(
    lambda q: (0.2 * q[0] * np.array([0.5, 0.7, 0.5]), np.array([1.0 * q[0], 0.5 * q[0], 2.0 * q[0]]))
)
"""A plate that turns about an axis out of the picture, and comes nearer."""


def differentiate(plate: Plate, points: np.ndarray, step: float = 1e-4) -> np.ndarray:
    """Motion of points of a plate per unit of its one coordinate, at the mean state."""
    after, before = (plate.carry(points, np.array([q])) for q in (step, -step))
    return (after - before) / (2 * step)


def cast(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Directions of the rays of pixels, of unit depth."""
    flat = (pixels - camera.middle) / camera.focal
    return np.concatenate([flat, np.ones_like(flat[..., :1])], -1) @ camera.rotation


def list_places(fine: int) -> np.ndarray:
    columns, rows = ((np.arange(fine * n) + 0.5) / fine for n in (WIDTH, HEIGHT))
    return np.stack(np.meshgrid(columns, rows), -1)


def film(plate: Plate, camera: Camera, states: np.ndarray, *, noise: float = 0.005) -> np.ndarray:
    """Frames of the plate at states before the wall, uint8."""
    rng, fine, pixels = np.random.default_rng(0), 2, list_places(2)
    rays = cast(camera, pixels)
    wall = camera.position + (WALL - camera.position[2]) / rays[..., 2:] * rays
    background, texture, frames = make_texture(99)(wall[..., :2]), make_texture(1), []
    for q in states:
        depth, material = plate.meet(camera, q, pixels)
        picture = np.where(np.isfinite(depth)[..., None], texture(material), background)
        mean = picture.reshape(HEIGHT, fine, WIDTH, fine, 3).mean((1, 3))
        frames.append(np.clip(mean + noise * rng.standard_normal(mean.shape), 0.0, 1.0))
    return np.round(255 * np.stack(frames)).astype(np.uint8)


def photograph(
    plate: Plate, states: np.ndarray, angles: Sequence[tuple[float, float]]
) -> tuple[np.ndarray, MatterScene]:
    """The recording of a plate, and its scene with views from yaws and pitches [deg]."""
    front = center_camera(np.eye(3), np.zeros(3), focal=FOCAL, height=HEIGHT, width=WIDTH)
    cameras = tuple(orbit_camera(front, FOCAL, yaw_deg=yaw, pitch_deg=pitch) for yaw, pitch in angles)
    depth, _ = plate.meet(front, np.zeros(states.shape[1]), list_places(1))
    depth = np.where(np.isfinite(depth), depth, WALL)
    views = None
    if cameras:
        images = np.stack([film(plate, camera, states) for camera in cameras], 1)
        names, held_out = tuple(map(str, angles)), np.zeros(len(cameras), bool)
        views = NovelViews(images, None, cameras, names, held_out, ViewSpace(front, FOCAL))
    return film(plate, front, states), MatterScene(depth, (*front.focal, *front.middle), views)
