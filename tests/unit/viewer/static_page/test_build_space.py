"""The page of a run in space against Python: the same order, the same ray, the same push."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.forces.grasp import NoMatterError
from lagsplat.forces.ray import cast_ray
from lagsplat.report.figures.forces import turn_camera
from lagsplat.splat.projection import compute_depths, make_view
from lagsplat.viewer.server.canvas import RayDrag
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
const view = viewOf(run);
console.log(JSON.stringify(sides.map((side) => {
  view.look(...side);
  const met = pixels.map((pixel) => view.cast(q, pixel));
  return { order: Array.from(view.order(q)), met, seen: pixels.map((pixel) => view.seen(view.under(pixel))) };
})));
"""
PUSH = """
const { run, side, from, drags } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const view = viewOf(run);
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
const view = viewOf(run);
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
    pixels = [(float(x), float(y)) for y in range(2, HEIGHT, 5) for x in range(2, WIDTH, 5)]
    data = {"run": pack_page(one), "q": q.tolist(), "sides": SIDES, "pixels": pixels}
    for side, result in zip(SIDES, run_script(MECHANICS, VIEW, data), strict=True):
        view = make_view([seen_from(one, side)])
        operating_point = one.operating_point
        raw = torch.from_numpy(operating_point.chart.to_raw(q[None].numpy())).float()
        with torch.no_grad():
            means = operating_point.autoencoder.gaussians.condition(raw).means
        ahead = compute_depths(means, view)[0].numpy()
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
                hit = cast_ray(operating_point.autoencoder, operating_point.chart, q, view, pixel)
            except NoMatterError:
                assert gaussian is None
                continue
            found += 1
            assert gaussian["k"] == hit.gaussian
            assert gaussian["depth"] == pytest.approx(hit.depth, abs=1e-4)
        assert found > len(pixels) // 2


@pytest.mark.parametrize("side", SIDES, ids=["front", "right", "left and near"])
def test_a_push_of_ten_seconds_is_the_same_in_the_page(one: Session, side) -> None:
    camera, steps = seen_from(one, side), round(SECONDS / one.dt_s)
    up = np.array([0.0, -4.0, 90.0])  # on the plate, above its middle
    pixel = tuple(camera.project(up[None])[0].tolist())
    drags = [None if i > 0.6 * steps else [9.0 * np.sin(0.05 * i), 0.5] for i in range(steps)]
    data = {"run": pack_page(one), "side": side, "from": pixel, "drags": drags}
    result = run_script(MECHANICS, PUSH, data)
    drag = RayDrag(one.operating_point, camera, np.array(pixel))
    one.to_rest()
    grasp = one.grasp(drag.find_target(one.q))
    np.testing.assert_allclose(result["at"], grasp.grasp_point.at, atol=1e-4)
    path = []
    for way in drags:
        one.release() if way is None else one.pull(drag.displacement(np.array(pixel) + way))
        one.step()
        path.append(one.q)
    assert np.abs(path).max() > 0.01
    np.testing.assert_allclose(result["path"], path, atol=1e-5 * np.abs(path).max())
    assert result["unexplained"] == pytest.approx(one.snapshot().energy.error, rel=1e-3)


def test_nothing_can_be_grasped_beside_the_object(one: Session) -> None:
    data = {"run": pack_page(one), "pixels": [[16, 8], [2, 2]]}
    assert run_script(MECHANICS, HOLD, data) == [True, False]
