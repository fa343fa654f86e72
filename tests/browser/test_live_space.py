"""The live page of a run in space, in a real browser: pushes from several sides, and a free camera."""

import time

import numpy as np
import pytest

from lagsplat.viewer.server.server import ViewerServer
from tests.browser.chromium import browser, until
from tests.browser.live_page import canvas_of, drag_from, middle, opened, settled
from tests.unit.forces.solid import FRONT, turning
from tests.unit.viewer.sessions import session

TOP = np.array([0.0, -3.0, FRONT])
"""On the plate, above the point about which it turns [px at the pivot]."""
BESIDE = np.array([-13.0, 3.0, FRONT])
BY = 60.0


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    plate = session(turning(), "viewer.port=0", "viewer.pictures_hz=6", "viewer.window=64")
    folder = tmp_path_factory.mktemp("live")
    frame = np.full((24, 32, 3), 90, np.uint8)
    one = ViewerServer(plate, title="Plate in space", read_frame=lambda number: frame, folder=folder)
    yield one
    one.stop()


@pytest.fixture(scope="module")
def page(live):
    with browser() as chromium:
        tab = opened(chromium, live)
        stands(live)
        yield tab


@pytest.fixture(autouse=True)
def at_rest(live):
    yield
    live.loop.submit(lambda session: (session.release(), session.to_rest(), session.pause(False)))


def at(page, live, place: np.ndarray) -> tuple[float, float]:
    """Where a place in space is on the screen, for the one visitor there is."""
    (client,) = live.server.get_clients().values()
    camera, box = live.scene_view.canvas.camera(client), canvas_of(page)
    x, y = camera.project(place[None])[0] / (camera.width, camera.height)
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def looks_from(live) -> np.ndarray:
    (client,) = live.server.get_clients().values()
    return live.scene_view.canvas.camera(client).position


def stands(live) -> None:
    """Wait until the view has glided to a stand."""
    (client,) = live.server.get_clients().values()

    def is_background() -> bool:
        before = client.camera.update_timestamp
        time.sleep(0.4)
        return client.camera.update_timestamp == before

    until(is_background, "a view that stands")


def turn(page, live) -> None:
    """Turn the view by a drag beside the plate."""
    eye = looks_from(live)
    drag_from(page, *at(page, live, BESIDE), 50.0)
    page.mouse.up()
    until(lambda: np.linalg.norm(looks_from(live) - eye) > 5.0, "another camera")
    stands(live)


def pushed(page, live, by: float) -> np.ndarray:
    """Drag the plate and hold it until the state has gone that way; the force."""
    session = live.session
    x, y = at(page, live, TOP)
    drag_from(page, x, y, by)
    grasp = until(
        lambda: (
            session.active_grasp is not None and session.active_grasp.force.any() and session.active_grasp
        ),
        "a push",
    )
    until(lambda: np.sign(by) * session.q[0] > 0.05, "a motion with the push")
    return grasp.force


def test_a_drag_moves_the_drawn_object_and_it_returns(page, live) -> None:
    session = live.session
    force = pushed(page, live, BY)
    assert force[0] > 0.0
    assert abs(force[2]) < 1e-9, "seen from the front, a drag does not push into the screen"
    page.mouse.up()
    until(lambda: session.active_grasp is None, "the release")
    live.loop.submit(lambda s: s.to_rest())
    before = settled(page)  # without the hint, which a push has removed
    live.loop.submit(lambda s: (s.to_frame(25), s.pause(True)))  # without the arrow over it
    until(lambda: middle(page) > before + 2.0, "drawn pixels to the right")
    live.loop.submit(lambda s: s.to_rest())
    until(lambda: abs(middle(page) - before) < 1.0, "drawn pixels back at rest")


def test_a_drag_beside_it_turns_the_camera_and_moves_nothing(page, live) -> None:
    session, before = live.session, live.session.q.copy()
    turn(page, live)
    assert session.active_grasp is None
    np.testing.assert_allclose(session.q, before, atol=1e-6)


def test_a_push_from_the_side_lies_in_the_plane_of_the_screen(page, live) -> None:
    if np.linalg.norm(looks_from(live)) < 5.0:
        turn(page, live)
    force = pushed(page, live, -BY)
    (client,) = live.server.get_clients().values()
    ahead = live.scene_view.canvas.camera(client).rotation[2]
    assert abs(ahead @ force) < 1e-3 * np.linalg.norm(force)
    assert abs(force[2]) > 0.05 * np.linalg.norm(force), "seen from the side, a drag also pushes into depth"
    page.mouse.up()
    until(lambda: live.session.active_grasp is None, "the release")


def test_a_button_returns_to_the_recording_camera(page, live) -> None:
    page.get_by_role("tab", name="View").click()
    page.get_by_label("Outline at rest").dispatch_event("click")
    until(lambda: live.scene_view.canvas.silhouettes.handles, "the outline")
    page.get_by_role("button", name="Look from the recording camera").dispatch_event("click")
    until(lambda: np.linalg.norm(looks_from(live)) < 0.1, "the film's camera")
    until(lambda: abs(middle(page) / canvas_of(page)["width"] - 0.5) < 0.1, "the picture from there")


def test_closing_a_tab_releases_its_grasp(page, live) -> None:
    session = live.session
    pushed(page, live, BY)
    page.close()
    until(lambda: session.active_grasp is None, "the release of a closed tab")
    assert live.loop.rates()[0] > 0
    until(lambda: not live.scene_view.canvas.drawn_keys, "a visitor that is forgotten")
