"""A scene in space small enough to train on in seconds: a bright ball that swings before a striped wall."""

import numpy as np

from lagsplat.views.camera import Camera, ViewSpace, arrange_cameras, look_at
from lagsplat.views.config import ArrangementConfig, SupervisionConfig
from lagsplat.views.novel import NovelViews

HEIGHT, WIDTH = 18, 24
SUPERVISION = SupervisionConfig(weight=1.0, spread=0.2)
ARRANGEMENT = ArrangementConfig(yaw_deg=15.0, pitch_deg=5.0, columns=3, rows=1, held_out=2)


def space() -> ViewSpace:
    """The film's camera, one unit before the ball."""
    front = look_at(
        np.zeros(3), distance=1.0, yaw_deg=0.0, pitch_deg=0.0, view_width=0.6, height=HEIGHT, width=WIDTH
    )
    return ViewSpace(front, 1.0)


def picture(camera: Camera, place: float) -> np.ndarray:
    """The ball at (place, 0, 0), radius 0.07, before a wall at z = 0.2 with soft stripes; (H, W, 3) uint8."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    ahead = np.stack(
        [
            (columns - camera.middle[0]) / camera.focal[0],
            (rows - camera.middle[1]) / camera.focal[1],
            np.ones_like(rows),
        ],
        axis=2,
    )
    rays = ahead @ camera.rotation
    wall = camera.position + (0.2 - camera.position[2]) / rays[..., 2:] * rays
    shade = 0.35 + 0.2 * np.sin(2 * np.pi * wall[..., 0] / 0.25)
    image = shade[..., None] * np.array([0.5, 0.7, 1.0])
    center = camera.project(np.array([[place, 0.0, 0.0]]))[0]
    radius = camera.focal[0] * 0.07 / camera.within(np.array([[place, 0.0, 0.0]]))[0, 2]
    cover = 1 / (1 + np.exp(3 * (np.hypot(columns - center[0], rows - center[1]) - radius)))[..., None]
    return np.round(255 * ((1 - cover) * image + cover * np.array([0.95, 0.4, 0.1]))).astype(np.uint8)


def swinging_ball(n: int) -> tuple[np.ndarray, NovelViews]:
    """``n`` filmed frames (n, H, W, 3), and the same instants from other sides."""
    place = 0.12 * np.sin(np.arange(n) / 3)
    cameras, names, held_out = arrange_cameras(space(), ARRANGEMENT)
    images = np.stack([[picture(camera, float(x)) for camera in cameras] for x in place])
    frames = np.stack([picture(space().reference, float(x)) for x in place])
    return frames, NovelViews(images, None, tuple(cameras), tuple(names), np.array(held_out), space())
