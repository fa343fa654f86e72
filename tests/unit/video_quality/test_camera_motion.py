"""A fixed camera before a large body that swings, and cameras that shift, turn and zoom."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from lagsplat.video_quality.camera_motion import measure_path, track_background

SHAPE = (160, 128)
FRAMES = 80
Camera = Callable[[float], tuple[float, float, float, float]]


def shelves() -> np.ndarray:
    """Books on two shelves, which look alike."""
    wall = np.full(SHAPE, 150.0, np.float32)
    rng = np.random.default_rng(1)
    for top in (10, 90):
        for left in range(4, SHAPE[1] - 12, 24):
            wall[top : top + 45, left : left + 14] = rng.uniform(70, 130)
        wall[top + 45 : top + 50] = 100.0
    return wall


def film(camera: Camera) -> list[np.ndarray]:
    """A bag of cloth, half as wide and high as the picture, that swings before shelves.

    ``camera`` gives shift (x, y) [pixel], turn [degree] and zoom of the picture at a share of the film.
    """
    rows, columns = SHAPE
    rng = np.random.default_rng(2)
    cloth = cv2.GaussianBlur(rng.normal(size=SHAPE), (0, 0), 1.2)
    cloth = (60.0 + 10.0 * cloth / cloth.std()).astype(np.float32)
    bag = np.zeros(SHAPE, np.float32)
    bag[50:130, 32:96] = 1.0
    wall, pictures = shelves(), []
    for share in np.arange(FRAMES) / FRAMES:
        swing = cv2.getRotationMatrix2D((columns / 2, 10), 20.0 * np.cos(40.0 * share), 1.0)
        there = cv2.warpAffine(bag, swing, (columns, rows))
        scene = (1.0 - there) * wall + there * cv2.warpAffine(cloth, swing, (columns, rows))
        x, y, turn, zoom = camera(share)
        view = cv2.getRotationMatrix2D((columns / 2, rows / 2), turn, zoom)
        view[:, 2] += (x, y)
        seen = cv2.warpAffine(
            scene, view, (columns, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
        noisy = seen + rng.normal(scale=1.0, size=SHAPE)
        pictures.append(np.clip(np.round(noisy), 0, 255).astype(np.uint8))
    return pictures


def measure_rms(camera: Camera) -> float:
    path = track_background(film(camera))
    assert path is not None
    return measure_path(path).rms_px


def test_a_large_body_that_swings_is_no_moving_camera() -> None:
    assert measure_rms(lambda share: (0.0, 0.0, 0.0, 1.0)) < 0.05


@pytest.mark.parametrize(
    ("camera", "rms_px"),
    [
        (lambda share: (3.0 * share, 0.0, 0.0, 1.0), 3.0 / np.sqrt(12.0)),
        (lambda share: (np.sin(300.0 * share), 0.0, 0.0, 1.0), 1.0 / np.sqrt(2.0)),
        (lambda share: (25.0 * share, 0.0, 0.0, 1.0), 25.0 / np.sqrt(12.0)),
        # both sides over the square root of twelve is the rms distance from the middle
        (lambda share: (0.0, 0.0, 2.0 * share, 1.0), np.radians(2.0) * np.hypot(*SHAPE) / 12.0),
        (lambda share: (0.0, 0.0, 0.0, 1.0 + 0.03 * share), 0.03 * np.hypot(*SHAPE) / 12.0),
    ],
    ids=["drift", "jitter", "pan", "turn", "zoom"],
)
def test_a_camera_that_moves_behind_it_is_measured(camera: Camera, rms_px: float) -> None:
    assert measure_rms(camera) == pytest.approx(rms_px, rel=0.1)
