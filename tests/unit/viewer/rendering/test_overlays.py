"""Overlays: arrows, outlines, and the ellipsoids that can be dragged."""

import numpy as np
import pytest
import torch

from lagsplat.splat.projection import SQUARE
from lagsplat.viewer.rendering.overlays import (
    OPAQUE,
    AccelerationField,
    DragProxies,
    make_ball,
    trace_outlines,
)
from lagsplat.viewer.rendering.scene_frame import FLIP
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import FRONT, turn_in_picture, turning


@pytest.mark.parametrize(("operating_point", "space"), [(rocking, 2), (turning, 3)], ids=["picture", "space"])
def test_arrows_start_on_moving_matter_and_point_along_its_motion(operating_point, space: int) -> None:
    field = AccelerationField(operating_point())
    arrows = field.arrows(np.zeros(1), np.ones(1), largest=1.0)
    assert len(np.unique(arrows[:, 0] // field.cell, axis=0)) == len(arrows)
    assert arrows.shape[1:] == (2, space)
    assert len(arrows) > 3
    assert (
        field.largest(np.zeros(1), np.ones(1))
        == np.linalg.norm(field.along(np.zeros(1), np.ones(1)), axis=1).max()
    )
    ways = arrows[:, 1] - arrows[:, 0]
    np.testing.assert_allclose(ways / (2.0 * field.cell), field.along(np.zeros(1), np.ones(1)), atol=1e-9)


def test_an_outline_runs_half_way_between_inside_and_outside() -> None:
    share = np.zeros((20, 30))
    share[5:15, 8:24] = 1.0
    (line,) = trace_outlines(share, smooth_px=0.5)
    np.testing.assert_allclose(line.min(0), (8.0, 5.0), atol=0.1)
    np.testing.assert_allclose(line.max(0), (24.0, 15.0), atol=0.1)


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


def test_an_ellipsoid_ends_where_its_gaussian_reaches_the_opacity_threshold(operating_point) -> None:
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
    opacity = operating_point.autoencoder.gaussians.opacity_logit.detach().sigmoid()[matter.chosen].numpy()
    left = opacity[:, None] * np.exp(-0.5 * (half / matter.sigma) ** 2)
    np.testing.assert_allclose(left, OPAQUE, rtol=1e-6)


def test_ellipsoids_follow_the_state_and_vanish_where_nothing_is_drawn(operating_point) -> None:
    matter = DragProxies(operating_point)
    before, _ = matter.ellipsoids(operating_point.rest.numpy())
    place, _ = matter.ellipsoids(operating_point.rest.numpy() + 0.7)
    ways = 0.1 * turn_in_picture(torch.from_numpy(before))[:, :, 0].numpy()  # of the plate, as drawn
    np.testing.assert_allclose(place, before + 0.7 * ways, atol=1e-4)
    _, half = matter.ellipsoids(operating_point.rest.numpy() + 50.0)
    assert half.max() < 1e-3


def test_orientations_are_unit_quaternions(operating_point) -> None:
    turned = DragProxies(operating_point).orientations(FLIP)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0)


def test_the_ball_is_round_and_closed() -> None:
    corners, faces = make_ball()
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 1.0)
    assert faces.shape == (20, 3)
    edges = {tuple(sorted((f[i], f[i - 1]))) for f in faces.tolist() for i in range(3)}
    assert len(corners) - len(edges) + len(faces) == 2
