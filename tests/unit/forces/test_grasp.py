"""Grasps by a brush and along a ray."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from lagsplat.evaluate.forces.motion import push_across, push_in_space
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.grasp import NoMatterError, follow_places, grasp_brush
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.forces.ray import cast_ray, find_matter_depth, place_on_ray
from lagsplat.matter.body_motion import make_body_at_rest
from lagsplat.matter.field import MatterField
from lagsplat.matter.film_registration import list_pixels
from lagsplat.monomials import make_wide_ball
from lagsplat.report.figures.forces import draw_space_push, turn_camera
from lagsplat.splat.projection import View, make_view
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import FOCAL, FRONT, HEIGHT, WALL, WIDTH, turning

STILL = torch.zeros(1, dtype=torch.float64)
PIVOT = torch.tensor([5.0, 15.0], dtype=torch.float64)


def bar() -> MatterField:
    """A rigid bar from (5, 5) to (15, 6) px that turns about `PIVOT` by one radian a unit of the state."""
    pixels = list_pixels(20, 20)
    points = pixels[(pixels[:, 0] > 5) & (pixels[:, 0] < 15) & (pixels[:, 1] > 5) & (pixels[:, 1] < 7)]
    motion = make_body_at_rest(points, make_wide_ball(1), bending=0)
    coefficients = torch.zeros_like(motion.coefficients)
    coefficients[0, 2] = 1.0
    motion = replace(motion, center=PIVOT, coefficients=coefficients)
    return MatterField((motion,), points, torch.zeros(len(points)).long())


@pytest.mark.parametrize("at", [(10.0, 6.0), (5.2, 5.1), (15.5, 6.5)])
def test_a_brush_holds_what_is_at_its_middle(at):
    matter = bar()
    grip = grasp_brush(matter, STILL, at, radius=2.0)
    arm = torch.tensor(at) - PIVOT
    torch.testing.assert_close(grip.jacobian(STILL)[:, 0], torch.stack([-arm[1], arm[0]]), atol=0.02, rtol=0)
    force = torch.tensor([3.0, 7.0], dtype=torch.float64)
    expected = float(-3.0 * arm[1] + 7.0 * arm[0])
    assert float(grip.pull_back(force, STILL)) == pytest.approx(expected, abs=0.2)


def test_a_brush_holds_one_body():
    left, right = bar(), bar()
    points = torch.cat([left.points, left.points + torch.tensor([10.0, 0.0])])
    still = make_body_at_rest(right.points, make_wide_ball(1), bending=0)
    body = (points[:, 0] > 15.0).long()
    matter = MatterField((left.bodies[0], still), points, body)
    assert grasp_brush(matter, STILL, (14.8, 6.0), radius=3.0).jacobian(STILL).norm() > 5.0
    assert grasp_brush(matter, STILL, (15.2, 6.0), radius=3.0).jacobian(STILL).norm() == 0.0


def test_a_grasp_follows_the_matter_along_its_arc():
    matter = bar()
    grip = grasp_brush(matter, STILL, (10.0, 6.0), radius=1.0)
    for turn in (0.7, -1.5, 3.0):
        q = torch.tensor([turn], dtype=torch.float64)
        arm = grip.points.at[0] - PIVOT
        cosine, sine = math.cos(turn), math.sin(turn)
        expected = PIVOT + torch.tensor([[cosine, -sine], [sine, cosine]]).double() @ arm
        torch.testing.assert_close(grip.place(q), expected, atol=0.05, rtol=0)
        assert float((grip.place(q) - PIVOT).norm()) == pytest.approx(float(arm.norm()), abs=0.05)


def test_a_grasp_in_another_state_holds_what_is_there_then():
    matter, q = bar(), torch.tensor([1.0], dtype=torch.float64)
    middle = matter.carry(q[None])[0].mean(0)
    grip = grasp_brush(matter, q, tuple(middle.tolist()), radius=1.0)
    torch.testing.assert_close(grip.place(q), middle)
    assert not grip.is_background
    assert grasp_brush(matter, STILL, tuple(middle.tolist()), radius=1.0).is_background


def test_off_matter_is_background_that_stays():
    places = torch.tensor([[6.5, 5.5], [2.0, 18.0]]).double()
    points, on_matter = follow_places(bar(), STILL, places, radius=1.0)
    assert on_matter.tolist() == [True, False]
    assert points.jacobian(STILL)[0].any()
    assert not points.jacobian(STILL)[1].any()
    turned = points.carry(torch.tensor([[0.0], [2.0]]).double())[:, 1]
    torch.testing.assert_close(turned, places[1].expand(2, -1))


def test_what_cannot_be_clicked_is_refused():
    take = partial(grasp_brush, bar(), radius=1.0, size=(10, 20))
    with pytest.raises(NoMatterError, match="outside the image of 20 x 10 px"):
        take(STILL, (20.5, 5.0))
    with pytest.raises(ValueError, match="not finite"):
        take(STILL * torch.nan, (4.0, 5.0))
    with pytest.raises(ValueError, match="not finite"):
        take(STILL, (math.nan, 5.0))
    with pytest.raises(ValueError, match="positive"):
        grasp_brush(bar(), STILL, (4.0, 5.0), radius=0.0)


CONFIG = ForcesConfig(brush=0.08, response=0.5, points=3, directions=4, levels=[1.0], periods=1.0, laws=10)
MIDDLE, CORNER = (WIDTH / 2, HEIGHT / 2), (2.0, 2.0)


@pytest.fixture(scope="module")
def operating_point() -> OperatingPoint:
    return turning()


def own(operating_point: OperatingPoint) -> View:
    return operating_point.autoencoder.filmed_view(operating_point.autoencoder.gaussians.center)


def test_a_ray_hits_the_plate_before_the_wall_and_the_wall_beside_it(operating_point: OperatingPoint) -> None:
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
        place = place_on_ray(own(operating_point), pixel, hit.depth)
        seen = turn_camera(operating_point, 0.0, 0.0).project(np.array([place]))[0]
        assert seen == pytest.approx(pixel, abs=1e-3)


def test_a_ray_from_the_side_hits_what_is_visible_there(operating_point: OperatingPoint) -> None:
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
    place = place_on_ray(make_view([camera]), (float(at[0]), float(at[1])), hit.depth)
    assert np.array(place) == pytest.approx(on_the_wall[0], abs=0.5)


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


def test_a_brush_in_space_needs_a_position_and_not_a_pixel(operating_point: OperatingPoint) -> None:
    with pytest.raises(ValueError, match="2 coordinates and matter has 3 dimensions"):
        operating_point.grasp(MIDDLE, radius=3.0)
    grip = operating_point.grasp((0.0, 0.0, FRONT), radius=2.0)
    expected = torch.tensor([[0.7], [0.0], [0.0]]).double()  # 0.1 x 7 px below
    torch.testing.assert_close(grip.jacobian(operating_point.rest), expected, atol=0.01, rtol=0)


@pytest.mark.parametrize(("wrong", "found"), [(1.0, FRONT), (0.97, FRONT), (1.2, FRONT), (0.8, 0.8 * FRONT)])
def test_a_ray_touches_matter_unless_something_hides_it(
    operating_point: OperatingPoint, wrong: float, found: float
) -> None:
    view, rest = own(operating_point), operating_point.rest
    hit = cast_ray(operating_point.autoencoder, operating_point.chart, rest, view, MIDDLE)
    depth = find_matter_depth(
        operating_point.matter, rest, view, MIDDLE, replace(hit, depth=wrong * hit.depth)
    )
    assert depth == pytest.approx(found, rel=1e-4)
    grip = operating_point.grasp(place_on_ray(view, MIDDLE, depth), radius=1.0)
    assert grip.is_background == (found != FRONT)


def test_beside_matter_a_ray_stays_on_what_is_drawn(operating_point: OperatingPoint) -> None:
    view, rest = own(operating_point), operating_point.rest
    hit = cast_ray(operating_point.autoencoder, operating_point.chart, rest, view, CORNER)
    assert find_matter_depth(operating_point.matter, rest, view, CORNER, hit) == hit.depth


def test_a_force_across_the_motion_moves_nothing_and_one_down_does(operating_point: OperatingPoint) -> None:
    push = push_in_space(operating_point, CONFIG)
    numbers = push.numbers()
    assert numbers["felt_across"] < 1e-15
    assert numbers["shift_across"] < 1e-12
    assert numbers["shift_down"] == pytest.approx(0.5 * operating_point.visited_radius, rel=0.1)
    assert push.hit.depth == pytest.approx(FRONT, abs=1e-3)
    assert abs(push.directions[0] @ push.grip.jacobian(operating_point.rest)[:, 0].numpy()) < 1e-15
    assert push.directions[0][2] > 0.99  # the plate never moves along the line of sight
    figure = draw_space_push(operating_point, push, title="toy")
    assert len(figure.axes) == 9


def test_the_direction_across_is_orthogonal_to_every_column_or_none() -> None:
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
