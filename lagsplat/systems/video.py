"""Render a simulated mechanism: video clips from its own camera, and true views from other cameras."""

import tempfile
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.io.recording.recording import Recording
from lagsplat.io.video.read import read_video
from lagsplat.systems.config import ReleaseConfig
from lagsplat.systems.mechanism import Poses, make_mechanism
from lagsplat.systems.rendering.painting import DrawnBody, Image, backdrop, paint_bodies
from lagsplat.systems.rendering.textures import SHAPES, photograph
from lagsplat.systems.truth import Series
from lagsplat.video_quality.frames import FrameSettings
from lagsplat.views.camera import Camera, ViewSpace, arrange_cameras, look_at
from lagsplat.views.config import ArrangementConfig
from lagsplat.views.novel import NovelViews


def make_camera(config: ReleaseConfig, *, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> Camera:
    """The scene's camera at the video's resolution, orbited around its target by these angles."""
    scene = config.scene
    return look_at(
        np.array([*scene.target, 0.0]),
        distance=scene.distance,
        yaw_deg=scene.yaw_deg + yaw_deg,
        pitch_deg=scene.pitch_deg + pitch_deg,
        view_width=scene.view_width,
        height=config.height * scene.film_scale,
        width=config.width * scene.film_scale,
    )


def film_clips(
    config: ReleaseConfig, poses: list[Poses], *, seed: int, camera: Camera | None = None
) -> Recording:
    """A recording of every clip by ``camera`` (None is the scene's), read back from encoded video files.

    Raises:
        ValueError: OpenCV cannot write the codec into the container, or returns fewer frames.
    """
    camera = camera or make_camera(config)
    scene, generator = config.scene, np.random.default_rng(seed)
    wall, bodies = set_up_scene(config, camera)
    with tempfile.TemporaryDirectory() as folder:
        for index, clip in enumerate(poses):
            path = Path(folder) / f"{index}.{scene.container}"
            _write(path, config, camera, wall, bodies, clip, generator)
        recording = read_video(folder, FrameSettings(size=(config.height, config.width)))
    written = sum(len(clip) for clip in poses)
    if recording.n_frames != written:
        raise ValueError(
            f"{written} frames were written and {recording.n_frames} read; choose another release.scene.codec"
        )
    return recording


def set_up_scene(config: ReleaseConfig, camera: Camera) -> tuple[Image, list[DrawnBody]]:
    """The wall from a camera, and the bodies at its scale."""
    scene, scale = config.scene, camera.focal[0] / config.scene.distance
    wall = backdrop(
        photograph(scene.background),
        camera,
        middle=(scene.target[0], scene.target[1]),
        behind=scene.behind,
        width=scene.background_width,
    )
    return wall, [DrawnBody(SHAPES[b.shape](b.size_m, scale), b.thickness_m, b.layers) for b in config.bodies]


def _write(
    path: Path,
    config: ReleaseConfig,
    camera: Camera,
    wall: np.ndarray,
    bodies: list[DrawnBody],
    poses: Poses,
    generator: np.random.Generator,
) -> None:
    codec, size = cv2.VideoWriter.fourcc(*config.scene.codec), (camera.width, camera.height)
    writer = cv2.VideoWriter(str(path), codec, 1.0 / config.dt_s, size)
    if not writer.isOpened():
        raise ValueError(
            f"OpenCV cannot write {config.scene.codec!r} into .{config.scene.container}; choose another "
            "release.scene.codec or container, such as mp4v and mp4"
        )
    try:
        for pose in poses:
            noise = generator.standard_normal(wall.shape, dtype=np.float32)
            clean = paint_bodies(wall, bodies, pose, camera)
            levels = 255 * clean + np.float32(config.scene.noise_levels) * noise
            image = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
            writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
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
        image = cv2.resize(paint_bodies(wall, bodies, pose, fine), size, interpolation=cv2.INTER_AREA)
        frames.append(np.clip(np.rint(255 * image), 0, 255).astype(np.uint8))
    return np.stack(frames)
