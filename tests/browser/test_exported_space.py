"""The exported page of a run in space: drawn as Python draws it from any side, pushed, and turned."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.report.figures.forces import turn_camera
from lagsplat.splat.projection import make_view
from lagsplat.viewer.static_page.build import save_page
from tests.browser.chromium import browser, until
from tests.browser.disc import TOP, WALL
from tests.browser.exported import at, drag, opened, pixels
from tests.unit.forces.solid import turning
from tests.unit.viewer.sessions import session

SIDES = ((0.0, 0.0, 1.0), (30.0, -12.0, 1.0), (-40.0, 25.0, 1.6))
"""Yaw and pitch [degree], and zoom."""
LOOK = "(side) => simulation.view.look(...side)"
# What moved towards the camera since it was taken hold of is drawn larger, and the arrow with it.
ARROW = """() => {
  const { session: { grip, q }, view } = simulation;
  const arrow = document.getElementById("arrow");
  const [x1, x2, y1, y2] = ["x1", "x2", "y1", "y2"].map((name) => Number(arrow.getAttribute(name)));
  return { across: x2 - x1, down: y2 - y1, larger: view.scale(grip.place(q)) / view.scale(grip.at) };
}"""


@pytest.fixture(scope="module")
def plate():
    return session(turning())


@pytest.fixture(scope="module")
def page(plate, tmp_path_factory):
    path = tmp_path_factory.mktemp("space") / "push.html"
    save_page(path, plate, title="Turning plate", subtitle="A run in miniature")
    with browser() as chromium, opened(chromium, path) as tab:
        yield tab


def looks(page) -> list[float]:
    return page.evaluate("[simulation.view.yaw, simulation.view.pitch, simulation.view.zoom]")


@pytest.mark.parametrize("side", SIDES, ids=["the film's camera", "right", "left and near"])
def test_the_image_is_the_one_that_python_draws(page, plate, side) -> None:
    state, (yaw, pitch, zoom) = 0.6, side
    page.evaluate(LOOK, side)
    drawn = pixels(page, [state])
    camera = turn_camera(plate.operating_point, yaw, pitch)
    view = make_view([replace(camera, focal=(zoom * camera.focal[0], zoom * camera.focal[1]))])
    q = torch.tensor([[state]], dtype=torch.float64)
    expected = 255.0 * plate.operating_point.render_images(q, scale=8, view=view)[0]
    assert np.ptp(expected) > 100.0
    assert np.abs(drawn - expected).max() < 2.5
    assert np.abs(drawn - expected).mean() < 0.4


def test_a_drag_on_the_object_pushes_it_and_beside_it_turns_the_view(page) -> None:
    page.evaluate("Object.assign(simulation.session, { paused: false }).rest()")
    page.locator("#front").click()
    drag(page, TOP, 12.0)
    until(lambda: page.evaluate("simulation.session.q[0]") > 0.02, "a motion")
    assert page.locator("#arrow").evaluate("node => node.style.visibility") == "visible"
    arrow = page.evaluate(ARROW)
    assert arrow["across"] == pytest.approx(12.0 * arrow["larger"], abs=1.0)
    assert arrow["down"] == pytest.approx(0.0, abs=1.0)
    assert looks(page) == [0, 0, 1]
    page.mouse.up()
    page.locator("#rest").click()
    drag(page, WALL, 120.0)
    page.mouse.up()
    yaw, pitch, _ = looks(page)
    assert yaw < -5.0
    assert pitch == 0.0
    assert page.evaluate("simulation.session.q") == page.evaluate("simulation.run.rest")
    page.mouse.move(*at(page, (2.0, 2.0)))
    page.mouse.wheel(0, -300)
    until(lambda: looks(page)[2] > 1.2, "a closer view")
    page.locator("summary", has_text="View").click()
    page.locator("#show-outline").check()
    page.locator("#show-velocity").check()
    until(lambda: page.locator("#velocity line").count() > 3, "arrows of the velocity")
    page.locator("#front").click()
    assert looks(page) == [0, 0, 1]


def test_two_fingers_beside_the_object_zoom(page) -> None:
    page.locator("#front").click()
    fingers = page.context.new_cdp_session(page)
    for step in range(6):
        ends = (at(page, (4.0 - 0.4 * step, 21.0)), at(page, (28.0 + 0.4 * step, 21.0)))
        touches = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(ends)]
        kind = "touchMove" if step else "touchStart"
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})
    fingers.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    yaw, pitch, zoom = until(lambda: (now := looks(page))[2] > 1.05 and now, "a closer view")
    assert (yaw, pitch) == (0, 0)
    assert zoom == pytest.approx(28.0 / 24.0, rel=0.05)


def test_a_push_from_the_side_lies_in_the_plane_of_the_image(page) -> None:
    page.evaluate(LOOK, (30.0, 0.0, 1.0))
    push = """() => {
      const { session, view } = simulation;
      const pixel = view.seen([0, -4, 90]);
      const { at } = session.grasp(pixel);
      const [from, to] = [pixel, [pixel[0] + 5, pixel[1]]].map((pointer) => view.under(pointer, at));
      session.pull(to.map((x, i) => x - from[i]));
      const force = session.grip.force;
      session.release();
      return force;
    }"""
    force = np.array(page.evaluate(push))
    yaw = np.deg2rad(30.0)
    np.testing.assert_allclose(force / np.linalg.norm(force), [np.cos(yaw), 0.0, np.sin(yaw)], atol=1e-6)
