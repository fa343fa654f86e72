"""The scene of a mechanism from other sides: what true cameras would have seen at the film's instants."""

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.systems.config import ReleaseConfig
from lagsplat.systems.mechanism import Poses, Series
from lagsplat.systems.release import make_mechanism
from lagsplat.systems.rendering.painting import paint_bodies
from lagsplat.systems.video import make_camera, set_up_scene
from lagsplat.views.camera import Camera, ViewSpace, arrange_cameras
from lagsplat.views.config import ArrangementConfig
from lagsplat.views.novel import NovelViews

FINE = 3
"""Samples of a pixel, each way."""


def make_space(config: ReleaseConfig) -> ViewSpace:
    """The coordinates of the scene's own camera at the recorded resolution, its target the pivot."""
    return ViewSpace(make_camera(config).resized(config.height, config.width), config.scene.distance)


def render_true_views(config: ReleaseConfig, states: Series, arrangement: ArrangementConfig) -> NovelViews:
    """Pictures of the states (T, d) from all sides, without noise and codec.

    Source: `lagsplat.systems.video` draws the film itself by the same means.
    """
    space = make_space(config)
    cameras, names, held_out = arrange_cameras(space, arrangement)
    poses = make_mechanism(config).poses(states)
    images = np.stack([photograph_scene(config, poses, camera) for camera in cameras], axis=1)
    return NovelViews(images, None, tuple(cameras), tuple(names), np.array(held_out), space)


def photograph_scene(config: ReleaseConfig, poses: Poses, camera: Camera) -> UInt8[np.ndarray, "T H W 3"]:
    """What a camera sees of the bodies in their poses."""
    fine = camera.resized(FINE * camera.height, FINE * camera.width)
    wall, bodies = set_up_scene(config, fine)
    return np.stack([_small(paint_bodies(wall, bodies, pose, fine), camera) for pose in poses])


def _small(picture: np.ndarray, camera: Camera) -> UInt8[np.ndarray, "H W 3"]:
    small = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.clip(np.rint(255 * small), 0, 255).astype(np.uint8)
