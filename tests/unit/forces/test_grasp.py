"""Grasps by a brush and along a ray."""

import math

import numpy as np
import pytest
import torch

from lagsplat.evaluate.forces.motion import push_across, push_in_space
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.equilibrium import OperatingPoint
from lagsplat.forces.grasp import (
    MatterKinematics,
    NoMatterError,
    cast_ray,
    compute_kinematics,
    grasp_along_ray,
    grasp_brush,
    grasp_nearest,
)
from lagsplat.report.figures.forces import draw_space_push, turn_camera
from lagsplat.splat.projection import View, make_view
from lagsplat.stage2.decoder_mass import DecoderGeometry
from tests.unit.evaluate.tiny_run import autoencoder, chart, recording
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import FOCAL, FRONT, HEIGHT, WALL, WIDTH, turning

STILL = torch.zeros(1, dtype=torch.float64)


def two() -> MatterKinematics:
    """One Gaussian that moves right and fades away from q = 0, and one that never moves."""
    return MatterKinematics(
        DecoderGeometry(
            jacobian=torch.tensor([[[2.0], [0.0]], [[0.0], [0.0]]], dtype=torch.float64),
            center=torch.zeros(2, 1, dtype=torch.float64),
            precision_factor=torch.ones(2, 1, 1, dtype=torch.float64),
            opacity=torch.tensor([0.5, 1.0], dtype=torch.float64),
        ),
        center=torch.tensor([[4.0, 5.0], [8.0, 5.0]], dtype=torch.float64),
        height=10,
        width=20,
    )


def test_weights_are_those_of_the_paper_and_sum_to_one():
    grip = grasp_brush(two(), STILL, (4.0, 5.0), radius=2.0)
    far = math.exp(-0.5 * (4.0 / 2.0) ** 2)
    share = 0.5 / (0.5 + far)
    assert float(grip.weights.sum()) == pytest.approx(1.0)
    assert float(grip.weights[0]) == pytest.approx(share)
    force = torch.tensor([3.0, 7.0], dtype=torch.float64)
    assert float(grip.pull_back(force)) == pytest.approx(share * 2.0 * 3.0)


def test_a_grasp_follows_the_matter():
    grip = grasp_brush(two(), STILL, (4.5, 5.5), radius=0.3)
    torch.testing.assert_close(
        grip.place(torch.tensor([1.5], dtype=torch.float64)), torch.tensor([7.5, 5.5], dtype=torch.float64)
    )


def test_the_nearest_grasp_is_one_gaussian():
    grip = grasp_nearest(two(), STILL, (7.0, 9.0))
    assert grip.weights.tolist() == [0.0, 1.0]
    assert float(grip.pull_back(torch.ones(2, dtype=torch.float64))) == 0.0


@pytest.mark.parametrize(
    "take", [lambda *a: grasp_brush(*a, radius=1.0), grasp_nearest], ids=["brush", "nearest"]
)
def test_a_point_outside_and_a_state_where_nothing_is_drawn_are_refused(take):
    with pytest.raises(NoMatterError, match="outside the image of 20 x 10 px"):
        take(two(), STILL, (20.5, 5.0))
    with pytest.raises(NoMatterError, match="no Gaussian is present at the state"):
        take(two(), STILL + 9.0, (4.0, 5.0))
    with pytest.raises(ValueError, match="not finite"):
        take(two(), STILL * torch.nan, (4.0, 5.0))
    with pytest.raises(ValueError, match="not finite"):
        take(two(), STILL, (math.nan, 5.0))


def test_a_click_on_the_background_colour_and_a_brush_without_width_are_refused():
    with pytest.raises(NoMatterError, match=r"nothing is present within a brush of 0\.5 px"):
        grasp_brush(two(), STILL, (15.0, 1.0), radius=0.5)
    with pytest.raises(ValueError, match="positive"):
        grasp_brush(two(), STILL, (4.0, 5.0), radius=0.0)


def test_the_kinematics_is_that_of_the_drawn_gaussians():
    model = autoencoder()
    of = chart(model, recording())
    kinematics = compute_kinematics(model, of)
    q = torch.from_numpy(of.latents[3:6])
    with torch.no_grad():
        drawn = model.gaussians.double().condition(torch.from_numpy(of.to_raw(of.latents[3:6])))
    torch.testing.assert_close(kinematics.places(q), drawn.means)
    torch.testing.assert_close(kinematics.presence(q), drawn.opacity)
    assert (kinematics.d, kinematics.height, kinematics.width) == (2, 16, 16)


CONFIG = ForcesConfig(brush=0.08, response=0.5, points=3, directions=4, levels=[1.0], periods=1.0)
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
        place = operating_point.kinematics.places(operating_point.rest[None])[0, hit.gaussian].numpy()
        seen = turn_camera(operating_point, 0.0, 0.0).project(place[None])[0]
        assert np.hypot(*(seen - pixel)) < 2.5


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


def test_a_brush_in_space_needs_a_position_and_not_a_pixel(operating_point: OperatingPoint) -> None:
    with pytest.raises(ValueError, match="2 coordinates and the Gaussians have 3 dimensions"):
        grasp_brush(operating_point.kinematics, operating_point.rest, MIDDLE, radius=3.0)
    grip = grasp_brush(operating_point.kinematics, operating_point.rest, (0.0, 0.0, FRONT), radius=2.0)
    assert grip.jacobian.shape == (3, 1)
    np.testing.assert_allclose(grip.jacobian[:, 0].numpy(), [0.7, 0.0, 0.0], atol=0.05)  # 0.1 x 7 px below


def test_a_grasp_along_a_ray_follows_its_gaussian(operating_point: OperatingPoint) -> None:
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
