"""Render a simulated mechanism: video clips from its own camera, and true views from other cameras."""

import tempfile
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.io.recording.recording import Recording
from lagsplat.io.video.read import read_video
from lagsplat.systems.config import ReleaseConfig
from lagsplat.systems.dynamics import Series
from lagsplat.systems.mechanism import Poses, make_mechanism
from lagsplat.systems.rendering import painting
from lagsplat.systems.rendering.textures import SHAPES
from lagsplat.systems.rendering.workshop import draw_wall
from lagsplat.video_quality.frames import FrameSettings
from lagsplat.views.camera import Camera, ViewSpace, arrange_cameras, look_at
from lagsplat.views.config import ArrangementConfig
from lagsplat.views.novel import NovelViews


def make_camera(config: ReleaseConfig) -> Camera:
    """The scene's camera at the video's resolution."""
    scene = config.scene
    return look_at(
        np.array([*scene.target, 0.0]),
        distance=scene.distance,
        yaw_deg=scene.yaw_deg,
        pitch_deg=scene.pitch_deg,
        view_width=scene.view_width,
        height=config.height * scene.film_scale,
        width=config.width * scene.film_scale,
    )


def set_up_scene(config: ReleaseConfig, camera: Camera) -> tuple[painting.Image, list[painting.DrawnBody]]:
    """The wall from a camera, and the bodies at its scale."""
    wall = painting.paint_backdrop(draw_wall(config.scene.background), camera, config.scene)
    return wall, draw_bodies(config, camera)


def draw_bodies(config: ReleaseConfig, camera: Camera) -> list[painting.DrawnBody]:
    """The bodies at the scale of a camera."""
    scale = camera.focal[0] / config.scene.distance
    return [
        painting.DrawnBody(SHAPES[b.shape](b.size_m, scale), b.thickness_m, b.layers) for b in config.bodies
    ]


def film_clips(config: ReleaseConfig, poses: list[Poses], *, seed: int) -> Recording:
    """A recording of every clip by the scene's camera, read back from encoded video files.

    Raises:
        ValueError: OpenCV cannot write the codec into the container, or returns fewer frames.
    """
    with tempfile.TemporaryDirectory() as folder:
        write_clips(config, poses, Path(folder), seed=seed)
        recording = read_video(folder, FrameSettings(size=(config.height, config.width)))
    written = sum(len(clip) for clip in poses)
    if recording.n_frames != written:
        raise ValueError(
            f"{written} frames were written and {recording.n_frames} read; choose another release.scene.codec"
        )
    return recording


def write_clips(config: ReleaseConfig, poses: list[Poses], folder: Path, *, seed: int) -> list[Path]:
    """Write a video of every clip by the scene's camera, named by its number; returns the files.

    Raises:
        ValueError: OpenCV cannot write the codec into the container.
    """
    camera, scene, generator = make_camera(config), config.scene, np.random.default_rng(seed)
    wall, bodies = set_up_scene(config, camera)
    paths = [folder / f"{index}.{scene.container}" for index in range(len(poses))]
    for path, clip in zip(paths, poses, strict=True):
        images = (painting.paint_bodies(wall, bodies, pose, camera) for pose in clip)
        _write_video(path, images, config, generator)
    return paths


def _write_video(
    path: Path, images: Iterable[painting.Image], config: ReleaseConfig, generator: np.random.Generator
) -> None:
    """Encode images in [0, 1] with the noise of the scene's camera."""
    scene, camera = config.scene, make_camera(config)
    size = (camera.width, camera.height)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*scene.codec), 1.0 / config.dt_s, size)
    if not writer.isOpened():
        raise ValueError(
            f"OpenCV cannot write {scene.codec!r} into .{scene.container}; choose another "
            "release.scene.codec or container, such as mp4v and mp4"
        )
    try:
        for clean in images:
            noisy = painting.add_camera_noise(clean, scene.noise_levels, generator)
            writer.write(cv2.cvtColor(noisy, cv2.COLOR_RGB2BGR))
    finally:
        writer.release()


FINE = 3  # samples per pixel along each axis


def make_space(config: ReleaseConfig) -> ViewSpace:
    """The coordinates of the scene's camera at the recorded resolution, with its target as pivot."""
    return ViewSpace(make_camera(config).resized(config.height, config.width), config.scene.distance)


def render_true_views(config: ReleaseConfig, states: Series, arrangement: ArrangementConfig) -> NovelViews:
    """Images of the states (T, d) from the arranged cameras, without noise and codec."""
    space = make_space(config)
    cameras, names, held_out = arrange_cameras(space, arrangement)
    poses = make_mechanism(config).poses(states)
    images = np.stack([photograph_scene(config, poses, camera) for camera in cameras], axis=1)
    return NovelViews(images, None, tuple(cameras), tuple(names), np.array(held_out), space)


def photograph_scene(config: ReleaseConfig, poses: Poses, camera: Camera) -> UInt8[np.ndarray, "T H W 3"]:
    """Render the bodies in their poses for a camera."""
    fine = camera.resized(FINE * camera.height, FINE * camera.width)
    wall, bodies = set_up_scene(config, fine)
    size = (camera.width, camera.height)
    frames = []
    for pose in poses:
        image = painting.paint_bodies(wall, bodies, pose, fine)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        frames.append(painting.round_to_levels(255 * image))
    return np.stack(frames)
