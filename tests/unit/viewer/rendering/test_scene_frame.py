"""Coordinates of the scene: pixels, lines of sight, and cameras of visitors."""

import numpy as np
import pytest

from lagsplat.viewer.rendering.scene_frame import ImagePlane, SceneFrame

PLANE = ImagePlane(120, 80)


def test_a_pixel_is_recovered_from_any_eye_in_front_of_the_image():
    places = np.array([[0.0, 0.0], [120.0, 80.0], [33.0, 71.0]])
    for eye in ((0.0, 0.0, 5.0), (3.0, -2.0, 4.0)):
        for place in places:
            # any point on the line of sight means the same place
            on = PLANE.to_scene(place)
            between = tuple(0.5 * (on + np.array(eye)))
            np.testing.assert_allclose(PLANE.to_pixels(between, eye=eye), place, atol=1e-9)


def test_the_first_row_is_on_top():
    top, bottom = PLANE.to_scene(np.array([[60.0, 0.0], [60.0, 80.0]]))
    assert top[1] > 0.0 > bottom[1]
    assert PLANE.size == (4.0, pytest.approx(8 / 3))


@pytest.mark.parametrize(
    ("point", "eye"),
    [
        ((0.0, 0.0, 6.0), (0.0, 0.0, 5.0)),
        ((1.0, 0.0, 5.0), (0.0, 0.0, 5.0)),
        ((np.nan, 0.0, 0.0), (0.0, 0.0, 5.0)),
        ((1e308, -1e308, 0.0), (0.0, 0.0, 5.0)),
        ((1e308, 0.0, 0.0), (-1e308, 0.0, 5.0)),
        ((1.0, 0.0, 5.0 - 1e-300), (0.0, 0.0, 5.0)),
    ],
    ids=["behind", "parallel", "nan", "huge", "huge between", "all but parallel"],
)
def test_a_line_of_sight_that_misses_the_image_is_refused(point, eye):
    with pytest.raises(ValueError, match=r"nothing was pushed|turn the view"):
        PLANE.to_pixels(point, eye=eye)


ROOM = SceneFrame(200.0, ImagePlane(120, 80))
EYE = {"wxyz": np.array([0.0, 1.0, 0.0, 0.0]), "position": np.array(ROOM.eye), "fov": 0.3, "aspect": 1.5}


def test_scene_and_space_coordinates_are_inverse_and_the_pivot_is_the_origin() -> None:
    points = np.array([[1.0, -2.0, 190.0], [0.0, 0.0, 0.0], [50.0, 7.0, 333.0]])
    np.testing.assert_allclose(ROOM.to_space(ROOM.to_scene(points)), points, atol=1e-12)
    np.testing.assert_array_equal(ROOM.to_scene(ROOM.pivot), np.zeros(3))
    np.testing.assert_allclose(ROOM.to_scene(np.zeros(3)), ROOM.eye)
    right, down, ahead = ROOM.to_scene(ROOM.pivot + 30.0 * np.eye(3))
    np.testing.assert_allclose((right, down, ahead), np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_a_visitor_at_the_recording_camera_has_its_view() -> None:
    camera = ROOM.camera(**EYE, side=96)
    np.testing.assert_allclose(camera.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(camera.position, np.zeros(3), atol=1e-9)
    assert (camera.height, camera.width) == (64, 96)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 1.5, 3.0])
def test_the_whole_image_fits_into_a_window_of_any_shape(aspect: float) -> None:
    camera = ROOM.camera(**{**EYE, "fov": ROOM.fov(aspect), "aspect": aspect}, side=200)
    corners = np.array([[-60.0, -40.0, 200.0], [60.0, 40.0, 200.0]])
    (left, top), (right, bottom) = camera.project(corners)
    assert 0.0 < left < right < camera.width
    assert 0.0 < top < bottom < camera.height
    assert max((right - left) / camera.width, (bottom - top) / camera.height) > 0.85


def test_a_slim_window_keeps_enough_pixels() -> None:
    camera = ROOM.camera(**{**EYE, "aspect": 1e9}, side=256)
    assert (camera.height, camera.width) == (32, 256)


@pytest.mark.parametrize(
    "changed",
    [
        {"wxyz": np.array([np.nan, 0.0, 0.0, 0.0])},
        {"wxyz": np.zeros(4)},
        {"wxyz": np.array([1e308, 0.0, 1e308, 0.0])},
        {"position": np.array([np.inf, 0.0, 0.0])},
        {"position": np.array([1e308, 0.0, 0.0])},
        {"fov": 0.0},
        {"fov": 4.0},
        {"fov": np.nan},
        {"aspect": -1.0},
        {"aspect": np.inf},
    ],
    ids=["nan", "zero", "huge", "endless", "far", "flat", "behind", "no angle", "negative", "line"],
)
def test_invalid_cameras_are_refused(changed: dict) -> None:
    with pytest.raises(ValueError, match="sees nothing"):
        ROOM.camera(**{**EYE, **changed}, side=64)
