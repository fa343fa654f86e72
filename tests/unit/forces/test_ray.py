"""A ray meets what the picture shows; a force across the motion moves nothing and one along it does."""

import numpy as np
import pytest
import torch

from lagsplat.evaluate.forces.motion import push_across, push_in_space
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.equilibrium import OperatingPoint
from lagsplat.forces.grasp import NoMatterError, cast_ray, grasp_along_ray, grasp_brush
from lagsplat.report.figures.forces import draw_space_push, turn_camera
from lagsplat.splat.projection import View, make_view
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import FOCAL, FRONT, HEIGHT, WALL, WIDTH, turning

CONFIG = ForcesConfig(brush=0.08, response=0.5, points=3, directions=4, levels=[1.0], periods=1.0)
MIDDLE, CORNER = (WIDTH / 2, HEIGHT / 2), (2.0, 2.0)


@pytest.fixture(scope="module")
def operating_point() -> OperatingPoint:
    return turning()


def own(operating_point: OperatingPoint) -> View:
    return operating_point.autoencoder.filmed_view(operating_point.autoencoder.gaussians.center)


def test_the_plate_is_met_before_the_wall_and_the_wall_beside_it(operating_point: OperatingPoint) -> None:
    for pixel, depth in ((MIDDLE, FRONT), (CORNER, WALL)):
        hit = cast_ray(
            operating_point.autoencoder,
            operating_point.chart,
            operating_point.rest,
            own(operating_point),
            pixel,
        )
        assert hit.depth == pytest.approx(depth, abs=1e-3)
        assert 0.5 < hit.cover < 1.0
        place = operating_point.kinematics.places(operating_point.rest[None])[0, hit.gaussian].numpy()
        seen = turn_camera(operating_point, 0.0, 0.0).project(place[None])[0]
        assert np.hypot(*(seen - pixel)) < 2.5


def test_from_the_side_the_ray_meets_what_stands_there(operating_point: OperatingPoint) -> None:
    camera = turn_camera(operating_point, 20.0, 0.0)
    on_the_wall = np.array([[-12.0 * WALL / FOCAL, -9.0 * WALL / FOCAL, WALL]])
    at = camera.project(on_the_wall)[0]
    hit = cast_ray(
        operating_point.autoencoder,
        operating_point.chart,
        operating_point.rest,
        make_view([camera]),
        (float(at[0]), float(at[1])),
    )
    place = operating_point.kinematics.places(operating_point.rest[None])[0, hit.gaussian].numpy()
    assert place[2] == pytest.approx(WALL)
    assert np.linalg.norm(place - on_the_wall[0]) < 3.0


def test_clicks_on_nothing_are_refused(operating_point: OperatingPoint) -> None:
    with pytest.raises(NoMatterError, match="outside the image of 32 x 24 px"):
        cast_ray(
            operating_point.autoencoder,
            operating_point.chart,
            operating_point.rest,
            own(operating_point),
            (40.0, 2.0),
        )
    with pytest.raises(NoMatterError, match=r"meets nothing: its opacity is only \d+%"):
        cast_ray(
            operating_point.autoencoder,
            operating_point.chart,
            operating_point.rest + 60.0,
            own(operating_point),
            MIDDLE,
        )
    with pytest.raises(ValueError, match="is not finite"):
        cast_ray(
            operating_point.autoencoder,
            operating_point.chart,
            operating_point.rest * torch.nan,
            own(operating_point),
            MIDDLE,
        )
    flat = rocking()
    with pytest.raises(ValueError, match="with a brush, not with a ray"):
        cast_ray(flat.autoencoder, flat.chart, flat.rest, own(operating_point), MIDDLE)


def test_a_brush_in_space_takes_a_place_and_not_a_pixel(operating_point: OperatingPoint) -> None:
    with pytest.raises(ValueError, match="2 coordinates and the Gaussians have 3 dimensions"):
        grasp_brush(operating_point.kinematics, operating_point.rest, MIDDLE, radius=3.0)
    grip = grasp_brush(operating_point.kinematics, operating_point.rest, (0.0, 0.0, FRONT), radius=2.0)
    assert grip.jacobian.shape == (3, 1)
    np.testing.assert_allclose(grip.jacobian[:, 0].numpy(), [0.7, 0.0, 0.0], atol=0.05)  # 0.1 x 7 px below


def test_a_grip_follows_its_gaussian(operating_point: OperatingPoint) -> None:
    hit = cast_ray(
        operating_point.autoencoder, operating_point.chart, operating_point.rest, own(operating_point), MIDDLE
    )
    grip = grasp_along_ray(operating_point.kinematics, operating_point.rest, hit.gaussian)
    q = operating_point.rest + 1.3
    torch.testing.assert_close(grip.place(q), operating_point.kinematics.places(q[None])[0, hit.gaussian])


def test_a_force_across_the_motion_moves_nothing_and_one_down_does(operating_point: OperatingPoint) -> None:
    push = push_in_space(operating_point, CONFIG)
    numbers = push.numbers()
    assert numbers["felt_across"] < 1e-15
    assert numbers["shift_across"] < 1e-12
    assert numbers["shift_down"] == pytest.approx(0.5 * operating_point.visited_radius, rel=0.1)
    assert push.hit.depth == pytest.approx(FRONT, abs=1e-3)
    assert abs(push.directions[0] @ push.grip.jacobian[:, 0].numpy()) < 1e-15
    assert push.directions[0][2] > 0.99  # the plate never moves along the line of sight
    figure = draw_space_push(operating_point, push, title="toy")
    assert len(figure.axes) == 9


def test_across_is_orthogonal_to_every_column_or_is_none() -> None:
    two = torch.randn(3, 2, dtype=torch.float64)
    found = push_across(two)
    assert np.linalg.norm(found) == pytest.approx(1.0)
    assert np.abs(found @ two.numpy()).max() < 1e-15
    np.testing.assert_allclose(
        push_across(torch.tensor([[0.0], [0.0], [2.0]], dtype=torch.float64)), [1, 0, 0]
    )
    np.testing.assert_allclose(push_across(torch.zeros(3, 1, dtype=torch.float64)), [0, 0, 1])
    with pytest.raises(ValueError, match="none is across"):
        push_across(torch.randn(3, 3, dtype=torch.float64))
