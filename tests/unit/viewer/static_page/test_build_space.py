"""The page of a run in space against Python: the same order, the same ray, the same push."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.forces.grasp import GraspPoint, NoMatterError, cast_ray, grasp_along_ray, grasp_brush
from lagsplat.report.figures.forces import turn_camera
from lagsplat.splat.projection import compute_depths, make_view
from lagsplat.viewer.simulation.session import Session
from lagsplat.viewer.static_page.build import MECHANICS, pack_page
from lagsplat.views.camera import Camera
from tests.unit.forces.solid import HEIGHT, WIDTH, turning
from tests.unit.viewer.scripts import run_script
from tests.unit.viewer.sessions import session

SECONDS = 10.0
SIDES = ((0.0, 0.0, 1.0), (25.0, -10.0, 1.0), (-40.0, 20.0, 1.8))
"""Yaw and pitch [degree], and zoom."""
VIEW = """
const { run, q, sides, pixels } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const view = viewOf(decode(run).splats);
console.log(JSON.stringify(sides.map((side) => {
  view.look(...side);
  const met = pixels.map((pixel) => view.cast(q, pixel));
  return { order: Array.from(view.order(q)), met, seen: pixels.map((pixel) => view.seen(view.under(pixel))) };
})));
"""
PUSH = """
const { run, side, from, drags } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const view = viewOf(decode(run).splats);
const session = new PageSession(run, lawOf(run.law), view);
view.look(...side);
const at = session.grasp(from).at;
const path = drags.map((drag) => {
  if (drag === null) session.release();
  else {
    const start = view.under(from, at);
    session.pull(view.under(from.map((x, i) => x + drag[i]), at).map((x, i) => x - start[i]));
  }
  session.step();
  return session.q;
});
console.log(JSON.stringify({ at, path, unexplained: session.unexplained() }));
"""
HOLD = """
const { run, pixels } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const view = viewOf(decode(run).splats);
console.log(JSON.stringify(pixels.map((pixel) => view.grasp(run.rest, pixel, 1) !== null)));
"""


@pytest.fixture(scope="module")
def one() -> Session:
    return session(turning())


def seen_from(one: Session, side: tuple[float, float, float]) -> Camera:
    camera = turn_camera(one.operating_point, *side[:2])
    return replace(camera, focal=(side[2] * camera.focal[0], side[2] * camera.focal[1]))


def test_python_and_page_agree_on_depth_and_grasp_from_every_side(one: Session) -> None:
    q = one.operating_point.rest + 0.4
    pixels = [(x, y) for y in np.arange(2.0, HEIGHT, 5.0) for x in np.arange(2.0, WIDTH, 5.0)]
    data = {"run": pack_page(one), "q": q.tolist(), "sides": SIDES, "pixels": pixels}
    for side, result in zip(SIDES, run_script(MECHANICS, VIEW, data), strict=True):
        view = make_view([seen_from(one, side)])
        ahead = compute_depths(one.operating_point.kinematics.places(q[None]).float(), view)[0].numpy()
        drawn = ahead[result["order"]]
        assert sorted(result["order"]) == list(range(len(ahead)))
        assert np.diff(drawn).max() < 1e-4  # from far to near
        ties = np.diff(drawn) == 0.0
        if side[:2] == (0.0, 0.0):  # then the wall is one depth, and the first one in front
            assert ties.sum() > 10
            assert (np.diff(result["order"])[ties] < 0).all()
        np.testing.assert_allclose(result["seen"], pixels, atol=1e-9)
        found = 0
        for pixel, gaussian in zip(pixels, result["met"], strict=True):
            try:
                hit = cast_ray(one.operating_point.autoencoder, one.operating_point.chart, q, view, pixel)
            except NoMatterError:
                assert gaussian is None
                continue
            found += 1
            assert gaussian["k"] == hit.gaussian
            assert gaussian["depth"] == pytest.approx(hit.depth, abs=1e-4)
        assert found > len(pixels) // 2


def taken(one: Session, camera: Camera, pixel: tuple[float, float]) -> tuple[GraspPoint, float]:
    """What a press takes hold of, and its depth."""
    operating_point = one.operating_point
    hit = cast_ray(
        operating_point.autoencoder, operating_point.chart, operating_point.rest, make_view([camera]), pixel
    )
    at = camera.position + hit.depth * camera.ray(pixel)
    try:
        return grasp_brush(
            operating_point.kinematics, operating_point.rest, tuple(at), radius=one.grasp_model.radius_px
        ), hit.depth
    except NoMatterError:
        return replace(
            grasp_along_ray(operating_point.kinematics, operating_point.rest, hit.gaussian),
            at=torch.from_numpy(at),
        ), hit.depth


@pytest.mark.parametrize("side", SIDES, ids=["front", "right", "left and near"])
def test_a_push_of_ten_seconds_is_the_same_in_the_page(one: Session, side) -> None:
    camera, steps = seen_from(one, side), round(SECONDS / one.dt_s)
    up = np.array([0.0, -4.0, 90.0])  # on the plate, above its middle
    pixel = tuple(camera.project(up[None])[0].tolist())
    drags = [None if i > 0.6 * steps else [3.0 * np.sin(0.05 * i), 0.5] for i in range(steps)]
    data = {"run": pack_page(one), "side": side, "from": pixel, "drags": drags}
    result = run_script(MECHANICS, PUSH, data)
    grasp_point, depth = taken(one, camera, pixel)
    np.testing.assert_allclose(result["at"], grasp_point.at, atol=1e-3)
    q, v, path = one.operating_point.rest.numpy(), np.zeros(1), []
    for drag in drags:
        force = np.zeros(3)
        if drag is not None:
            ways = one.grasp_model.gain * depth * np.array(drag) / np.array(camera.focal)
            force = ways @ camera.rotation[:2]
        load = grasp_point.pull_back(torch.from_numpy(force)).numpy()
        q, v = one.law.step(q, v, one.u, load, dt_s=one.dt_s)
        path.append(q)
    assert np.abs(path).max() > 0.01
    np.testing.assert_allclose(result["path"], path, atol=1e-4 * np.abs(path).max())
    assert abs(result["unexplained"]) < 1e-3


def test_nothing_can_be_grasped_beside_the_object(one: Session) -> None:
    data = {"run": pack_page(one), "pixels": [[16, 8], [2, 2]]}
    assert run_script(MECHANICS, HOLD, data) == [True, False]
