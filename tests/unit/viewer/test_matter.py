"""What can be dragged in space: ellipsoids that are the Gaussians, follow them, and fade with them."""

import numpy as np
import pytest
import torch

from lagsplat.splat.projection import SQUARE
from lagsplat.viewer.rendering.overlays import OPAQUE, DragProxies, make_ball
from lagsplat.viewer.rendering.scene_frame import FLIP
from tests.unit.forces.solid import FRONT, turning


@pytest.fixture(scope="module")
def operating_point():
    one = turning()
    with torch.no_grad():  # no longer round, so that the axes mean something
        one.autoencoder.gaussians.shape_log_diagonal.copy_(
            torch.tensor([0.2, -0.4, -1.0]).expand(one.autoencoder.gaussians.n, 3)
        )
        one.autoencoder.gaussians.shape_below.fill_(0.3)
    return one


def test_the_plate_can_be_dragged_and_the_wall_cannot(operating_point) -> None:
    place, half = DragProxies(operating_point).ellipsoids(operating_point.rest.numpy())
    assert len(place) > 20
    np.testing.assert_allclose(place[:, 2], FRONT)
    assert (half > 0.05).all()


def test_an_ellipsoid_is_where_its_gaussian_stops_so_much_light(operating_point) -> None:
    matter = DragProxies(operating_point)
    covariance = (
        operating_point.autoencoder.gaussians.covariance()
        .detach()[matter.chosen][:, SQUARE]
        .unflatten(1, (3, 3))
    )
    rebuilt = matter.axes * matter.sigma[:, None] ** 2 @ np.swapaxes(matter.axes, 1, 2)
    np.testing.assert_allclose(rebuilt, covariance.numpy(), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(matter.axes), 1.0)
    _, half = matter.ellipsoids(operating_point.rest.numpy())
    present = operating_point.kinematics.presence(operating_point.rest[None])[0, matter.chosen].numpy()
    left = present[:, None] * np.exp(-0.5 * (half / matter.sigma) ** 2)
    np.testing.assert_allclose(left, OPAQUE, rtol=1e-6)


def test_it_follows_the_state_and_fades_where_nothing_is_drawn(operating_point) -> None:
    matter = DragProxies(operating_point)
    q = operating_point.rest.numpy() + 0.7
    place, _ = matter.ellipsoids(q)
    expected = operating_point.kinematics.places(torch.from_numpy(q)[None])[0, matter.chosen].numpy()
    np.testing.assert_allclose(place, expected)
    _, half = matter.ellipsoids(operating_point.rest.numpy() + 50.0)
    assert half.max() < 1e-3


def test_turns_are_unit_quaternions_of_the_scene(operating_point) -> None:
    turned = DragProxies(operating_point).orientations(FLIP)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0)


def test_the_ball_is_round_and_closed() -> None:
    corners, faces = make_ball()
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 1.0)
    assert faces.shape == (20, 3)
    edges = {tuple(sorted((f[i], f[i - 1]))) for f in faces.tolist() for i in range(3)}
    assert len(corners) - len(edges) + len(faces) == 2
