"""The camera sees what it is turned to, at the size it says, and a plane as it sees its points."""

import numpy as np
import pytest

from lagsplat.views.camera import look_at

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
