"""The live page in a real browser: drags, controls, a tab that closes, two tabs at once."""

import time

import numpy as np
import pytest

from lagsplat.viewer.server.server import ViewerServer
from tests.browser.chromium import NO_WEBGL, PATIENCE_S, browser, until
from tests.browser.disc import SIZE, TOP, WALL, disc
from tests.browser.live_page import VIEW, canvas_of, drag_from, middle, opened, settled


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    session = disc("viewer.port=0", "viewer.pictures_hz=6", "viewer.side=48")
    folder = tmp_path_factory.mktemp("live")
    frame = np.full((24, 32, 3), 90, np.uint8)
    one = ViewerServer(session, title="Rocking disc", read_frame=lambda number: frame, folder=folder)
    yield one
    one.stop()


@pytest.fixture(scope="module")
def chromium():
    with browser() as one:
        yield one


@pytest.fixture
def page(chromium, live):
    tab = opened(chromium, live)
    yield tab
    tab.close()
    live.loop.submit(lambda session: (session.release(), session.to_rest()))


def at(page, live, place: tuple[float, float]) -> tuple[float, float]:
    """Where a place of the picture [px] is on the screen: the camera faces the picture's middle."""
    box, canvas = canvas_of(page), live.scene_view.canvas
    fov = canvas.choose_fov(box["width"] / box["height"])
    unit = 0.5 * box["height"] / (canvas.far * np.tan(0.5 * fov)) / canvas.image_plane.unit
    x = box["x"] + 0.5 * box["width"] + unit * (place[0] - 0.5 * SIZE[0])
    return x, box["y"] + 0.5 * box["height"] + unit * (place[1] - 0.5 * SIZE[1])


def drag(page, live, place: tuple[float, float], by: float) -> None:
    drag_from(page, *at(page, live, place), by)


def test_a_drag_pushes_the_matter_under_the_pointer_until_its_release(page, live) -> None:
    session = live.session
    drag(page, live, TOP, 60.0)
    grasp = until(
        lambda: (
            session.active_grasp is not None and session.active_grasp.force[0] > 0 and session.active_grasp
        ),
        "a push",
    )
    np.testing.assert_allclose(grasp.grasp_point.at, TOP, atol=1.0)
    place = until(lambda: (p := grasp.place(session.q)[0]) > TOP[0] + 0.3 and p, "a motion to the right")
    assert place < SIZE[0]
    page.mouse.up()
    until(lambda: session.active_grasp is None, "the release")
    live.loop.submit(lambda s: s.edit(damping=5.0))
    until(lambda: abs(grasp.place(session.q)[0] - TOP[0]) < 0.2, "the return to rest")
    live.loop.submit(lambda s: s.edit(damping=1.0))


def test_the_drawn_object_moves_in_the_pushed_direction_and_returns(page, live) -> None:
    before = settled(page)
    drag(page, live, TOP, 60.0)
    until(lambda: live.session.active_grasp is not None, "a push")
    time.sleep(0.5)
    page.mouse.up()
    until(lambda: live.session.active_grasp is None, "the release")
    live.loop.submit(lambda s: s.to_frame(25))  # pushed or started to the right, without the arrow over it
    live.loop.submit(lambda s: s.pause(True))
    until(lambda: middle(page) > before + 2.0, "drawn pixels to the right")
    live.loop.submit(lambda s: s.to_rest())
    until(lambda: abs(middle(page) - before) < 1.0, "drawn pixels back at rest")
    live.loop.submit(lambda s: s.pause(False))


def test_a_drag_beyond_the_recording_shows_a_banner(page, live) -> None:
    drag(page, live, TOP, 350.0)
    until(lambda: "Beyond the recording" in live.session.snapshot().banner, "a state beyond")
    live.loop.submit(lambda s: s.pause(True))
    until(lambda: page.get_by_text("Beyond the recording").is_visible(), "the banner")
    page.mouse.up()
    live.loop.submit(lambda s: s.pause(False))


def test_a_drag_on_the_wall_moves_nothing(page, live) -> None:
    session = live.session
    rest = session.q.copy()
    drag(page, live, WALL, 80.0)
    until(lambda: session.active_grasp is not None, "a hold of the wall")
    time.sleep(0.5)
    np.testing.assert_allclose(session.q, rest, atol=1e-3)
    page.mouse.up()
    until(lambda: session.active_grasp is None, "the release")


def test_keys_push_pause_and_rest_and_leave_the_camera(page, live) -> None:
    session, client = live.session, list(live.server.get_clients().values())[-1]
    eye = tuple(client.camera.position)
    page.keyboard.down("ArrowRight")
    until(lambda: session.active_grasp is not None and session.active_grasp.force[0] > 0, "a push")
    time.sleep(0.5)
    page.keyboard.up("ArrowRight")
    until(lambda: session.active_grasp is None, "the release")
    assert tuple(client.camera.position) == pytest.approx(eye)
    for status in ("paused", "running"):
        page.keyboard.press("Space")
        until(lambda status=status: session.status == status, status)
    page.keyboard.press("r")
    until(lambda: session.frame is None and np.abs(session.v).max() < 1e-6, "rest")


def test_controls_reach_the_session(page, live) -> None:
    session = live.session
    page.get_by_role("button", name="Pause").dispatch_event("click")
    until(lambda: session.status == "paused", "the pause")
    steps = session.steps
    page.get_by_role("button", name="Step").dispatch_event("click")
    until(lambda: session.steps == steps + 1, "a single step")
    page.get_by_role("button", name="Run").dispatch_event("click")
    until(lambda: session.status == "running", "running again")
    page.get_by_role("tab", name="Mechanics").click()
    slider = (
        page.get_by_text("Damping (×)", exact=True)
        .locator("xpath=ancestor::*[.//*[@role='slider']][1]")
        .get_by_role("slider")
    )
    slider.press("ArrowRight")
    until(lambda: session.edits.damping == pytest.approx(1.05), "more damping")
    page.get_by_role("button", name="As learned").dispatch_event("click")
    until(lambda: session.edits.damping == 1.0, "damping as learned")
    page.get_by_role("tab", name="View").click()
    page.get_by_label("Outline at rest").dispatch_event("click")
    until(lambda: live.scene_view.shown["outline"], "the outline")
    page.get_by_role("tab", name="Record").click()
    page.get_by_role("button", name="Save the session").dispatch_event("click")
    until(
        lambda: {p.suffix for p in live.folder.glob("session_*")} == {".mcap", ".mp4", ".gif"},
        "files",
    )
    page.get_by_role("button", name="Replay what I did").dispatch_event("click")
    until(lambda: session.replaying is not None, "the replay")
    page.get_by_role("button", name="Rest").dispatch_event("click")
    until(lambda: session.frame is None and not session.v.any(), "rest")


def test_closing_a_tab_releases_its_grasp_and_it_may_return(chromium, live) -> None:
    session = live.session
    tab = opened(chromium, live)
    drag(tab, live, TOP, 60.0)
    until(lambda: session.active_grasp is not None, "a push")
    tab.close()
    until(lambda: session.active_grasp is None, "the release of a closed tab")
    again = opened(chromium, live)
    drag(again, live, TOP, -60.0)
    until(
        lambda: session.active_grasp is not None and session.active_grasp.force[0] < 0,
        "a push of the new tab",
    )
    again.mouse.up()
    until(lambda: session.active_grasp is None, "its release")
    again.close()


def test_two_tabs_see_the_same_and_the_last_grasp_holds(chromium, live) -> None:
    session = live.session
    one, two = opened(chromium, live), opened(chromium, live)
    drag(one, live, TOP, 60.0)
    until(lambda: session.active_grasp is not None and session.active_grasp.force[0] > 0, "the first hand")
    drag(two, live, TOP, -60.0)
    until(lambda: session.active_grasp is not None and session.active_grasp.force[0] < 0, "the second hand")
    one.mouse.up()
    time.sleep(0.3)
    assert session.active_grasp is not None
    two.mouse.up()
    until(lambda: session.active_grasp is None, "the release")
    live.loop.submit(lambda s: (s.to_frame(25), s.pause(True)))
    until(lambda: abs(middle(one) - middle(two)) < 1.0, "the same picture in both")
    live.loop.submit(lambda s: (s.pause(False), s.to_rest()))
    one.close()
    two.close()


def test_colours_are_those_that_the_browser_asks_for(chromium, live) -> None:
    live.loop.submit(lambda s: s.to_frame(25))
    context = chromium.new_context(viewport=VIEW, color_scheme="dark")
    tab = context.new_page()
    tab.set_default_timeout(1000 * PATIENCE_S)
    tab.goto(live.url)
    scheme = tab.locator("html")
    until(lambda: scheme.get_attribute("data-mantine-color-scheme") == "dark", "dark colours")
    tab.emulate_media(color_scheme="light")
    until(lambda: scheme.get_attribute("data-mantine-color-scheme") == "light", "light colours")
    tab.locator("#theme").dispatch_event("click")
    until(lambda: scheme.get_attribute("data-mantine-color-scheme") == "dark", "colours as chosen")
    context.close()


def test_without_webgl_the_page_says_so(chromium, live) -> None:
    context = chromium.new_context(viewport=VIEW)
    context.add_init_script(NO_WEBGL)
    tab = context.new_page()
    tab.goto(live.url)
    until(lambda: "WebGL is unavailable" in tab.locator("body").inner_text(), "the words")
    context.close()
