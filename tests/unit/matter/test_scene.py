"""The space of a film: depth as drawn, what other cameras see, and which of them are asked."""

from dataclasses import replace

import numpy as np
import torch

from lagsplat.matter.depth import draw_depth
from lagsplat.matter.occlusion import DepthBuffer
from lagsplat.matter.scene import MOST_VIEWS, choose_views, make_scene
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.views.camera import orbit_camera
from tests.unit.forces import solid
from tests.unit.matter.space_films import FOCAL, HEIGHT, TILTED, WALL, WIDTH, photograph

SIDES = [(yaw, pitch) for pitch in (-6.0, 0.0, 6.0) for yaw in (-15.0, -7.0, 0.0, 7.0, 15.0)]


def test_the_depth_is_that_of_what_is_in_front() -> None:
    point = solid.turning()
    model = point.autoencoder
    depth = draw_depth(model, np.zeros(1))
    assert depth.shape == (solid.HEIGHT, solid.WIDTH)
    np.testing.assert_allclose(depth[9:15, 13:19], solid.FRONT, rtol=0.02)
    np.testing.assert_allclose(depth[:, [1, -2]], solid.WALL, rtol=0.02)
    with torch.no_grad():
        model.gaussians.opacity_logit[model.gaussians.center[:, 0] > 8.0] = -9.0
    holes = np.isnan(draw_depth(model, np.zeros(1)))
    assert holes[:, 25:].all()
    assert not holes[:, :20].any()


def test_the_scene_of_a_run_has_the_depth_at_the_mean_state() -> None:
    point = solid.turning()
    scene = make_scene(point.autoencoder, replace(point.chart, mean=np.array([0.4])), None)
    assert scene is not None
    np.testing.assert_array_equal(scene.depth, draw_depth(point.autoencoder, np.array([0.4])))
    assert scene.camera.focal == (solid.FOCAL, solid.FOCAL)
    points = scene.lift_pixels().numpy()
    np.testing.assert_allclose(scene.camera.project(points)[solid.WIDTH], [0.5, 1.5])
    np.testing.assert_array_equal(points[:, 2], scene.depth.ravel())
    size = {"height": solid.HEIGHT, "width": solid.WIDTH}
    flat = Autoencoder(d=1, n_gaussians=4, kernel=12, channels=2, background="black", **size)
    assert make_scene(flat, point.chart, None) is None


def test_the_chosen_views_are_far_apart_and_never_held_out() -> None:
    _, scene = photograph(TILTED, np.zeros((1, 1)), SIDES)
    assert scene.views is not None
    chosen = choose_views(scene.views)
    assert len(chosen) == MOST_VIEWS
    assert {SIDES[number] for number in chosen} == {(x, y) for x in (-15.0, 15.0) for y in (-6.0, 6.0)}
    held_out = np.array([number in chosen[:2] for number in range(len(SIDES))])
    assert not set(chosen[:2]) & set(choose_views(replace(scene.views, held_out=held_out)))
    few = np.arange(len(SIDES)) > 1
    assert sorted(choose_views(replace(scene.views, held_out=few))) == [0, 1]


def test_from_the_side_the_plate_hides_the_wall_behind_it() -> None:
    _, scene = photograph(TILTED, np.zeros((1, 1)), ())
    aside = orbit_camera(scene.camera, FOCAL, yaw_deg=15.0, pitch_deg=0.0)
    points = scene.lift_pixels()
    shown = DepthBuffer(points, aside).shows(points).numpy()
    plate = points[:, 2].numpy() < WALL
    behind = ~plate & TILTED.meets(aside, points.numpy())
    assert behind.sum() > 30
    assert shown[plate].all()
    assert not shown[behind].any()
    places = aside.project(points.numpy())
    inside = ((places > 0.0) & (places < [WIDTH, HEIGHT])).all(1)
    assert shown[inside & ~behind].mean() > 0.9
    assert not shown[~inside].any()
    outside = torch.tensor([[0.0, 0.0, -10.0], [500.0, 0.0, FOCAL], [np.nan, 0.0, 0.0]]).double()
    assert not DepthBuffer(points, aside).shows(outside).any()
