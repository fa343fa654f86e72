"""The camera sees what it is turned to, at the size it says, and a plane as it sees its points."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.views.camera import look_at, orbit_camera

TARGET = np.array([0.3, -0.2, 0.1])


def camera(yaw_deg: float = 0.0, pitch_deg: float = 0.0):
    return look_at(
        TARGET, distance=2.0, yaw_deg=yaw_deg, pitch_deg=pitch_deg, view_width=0.5, height=40, width=60
    )


@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (40, 0), (0, 30), (-25, 15)])
def test_the_target_is_in_the_middle_and_the_axes_are_orthonormal(yaw: float, pitch: float) -> None:
    view = camera(yaw, pitch)
    np.testing.assert_allclose(view.project(TARGET[None])[0], [30, 20], atol=1e-9)
    np.testing.assert_allclose(view.rotation @ view.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view.rotation) == pytest.approx(1.0)


def test_the_frontal_view_has_right_to_the_right_down_below_and_the_stated_width() -> None:
    points = camera().project(TARGET + np.array([[0.25, 0, 0], [0, 0.1, 0]]))
    np.testing.assert_allclose(points, [[60, 20], [30, 32]], atol=1e-9)


def test_a_camera_moved_right_and_up_sees_the_front_move_left_and_down() -> None:
    nearer = TARGET - np.array([0.0, 0.0, 0.1])
    right, up = camera(yaw_deg=20).project(nearer[None])[0], camera(pitch_deg=20).project(nearer[None])[0]
    assert right[0] < 30 - 1
    assert up[1] > 20 + 1


def test_a_plane_is_seen_as_its_points_are() -> None:
    view = camera(30, 10)
    origin, across, down = np.array([0.1, 0.0, 0.3]), np.array([0.6, 0.1, 0.2]), np.array([0.0, 0.5, 0.1])
    spots = np.array([[0.2, 0.4], [-0.3, 0.1]])
    seen = np.hstack([spots, np.ones((2, 1))]) @ view.of_plane(origin, across, down).T
    np.testing.assert_allclose(
        seen[:, :2] / seen[:, 2:], view.project(origin + spots @ np.stack([across, down])), atol=1e-9
    )


def test_an_orbit_keeps_its_pivot_in_place_and_no_turn_is_the_camera_itself() -> None:
    view = camera(15, 5)
    pivot = view.position + 1.3 * view.rotation[2]
    moved = orbit_camera(view, 1.3, yaw_deg=12.0, pitch_deg=-4.0)
    np.testing.assert_allclose(moved.project(pivot[None]), view.project(pivot[None]), atol=1e-9)
    assert np.linalg.norm(moved.position - pivot) == pytest.approx(1.3)
    still = orbit_camera(view, 1.3, yaw_deg=0.0, pitch_deg=0.0)
    np.testing.assert_allclose(still.position, view.position, atol=1e-12)
    np.testing.assert_allclose(still.rotation, view.rotation, atol=1e-12)


def test_a_resized_camera_sees_the_same_picture_in_other_pixels() -> None:
    view = replace(camera(20, 5), focal=(200.0, 180.0), middle=(31.0, 18.0))
    small = view.resized(20, 15)
    points = TARGET + np.array([[0.1, 0.05, -0.2], [-0.05, 0.0, 0.3]])
    np.testing.assert_allclose(small.project(points), view.project(points) * [0.25, 0.5], atol=1e-9)


def test_a_ray_passes_through_what_its_pixel_shows() -> None:
    view = replace(camera(20, 5), focal=(200.0, 180.0), middle=(31.0, 18.0))
    along = view.position + 1.7 * view.ray((12.3, 33.1))
    np.testing.assert_allclose(view.project(along[None])[0], [12.3, 33.1], atol=1e-9)
    assert view.within(along[None])[0, 2] == pytest.approx(1.7)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotation": 1.01 * np.eye(3)}, "misses the identity by 0.02"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "determinant is -1"),
        ({"rotation": np.full((3, 3), np.nan)}, "pose is not finite"),
        ({"position": np.zeros(2)}, r"not \(3, 3\) and \(2,\)"),
        ({"focal": (100.0, 0.0)}, "focal lengths are positive"),
        ({"width": 0}, "camera of 40 x 0 pixels"),
        ({"middle": (np.inf, 1.0)}, "principal point"),
    ],
)
def test_a_camera_that_is_none_is_refused(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(camera(), **change)
