"""The exported page in a real browser, from disk and with the network off."""

import time
from functools import partial

import numpy as np
import pytest
import torch

from lagsplat.viewer.static_page.build import save_page
from tests.browser.chromium import NO_WEBGL, browser, seen, until
from tests.browser.disc import SIZE, TOP, WALL, disc
from tests.browser.exported import DRAWN, drag, opened, pixels


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    page = tmp_path_factory.mktemp("page") / "push.html"
    save_page(page, disc(), title="Rocking disc", subtitle="A run in miniature")
    return page


@pytest.fixture(scope="module")
def chromium():
    with browser() as one:
        yield one


@pytest.fixture
def page(chromium, path):
    with opened(chromium, path) as tab:
        yield tab


def bright_middle(page) -> float:
    """Column of the middle of what is bright in the drawn picture, without the arrow over it [its pixels]."""
    page.evaluate("document.getElementById('over').style.display = 'none'")
    picture = seen(page, page.locator("#drawn").bounding_box()).sum(2)
    page.evaluate("document.getElementById('over').style.display = ''")
    ink = np.clip(picture - 400.0, 0.0, None).sum(0)
    return float((ink * np.arange(len(ink))).sum() / ink.sum())


@pytest.mark.parametrize("by", [120.0, -120.0], ids=["right", "left"])
def test_a_drag_moves_the_object_with_it_and_it_returns(page, by: float) -> None:
    before = bright_middle(page)
    drag(page, TOP, by)
    moved = until(lambda: abs(m := bright_middle(page) - before) > 2.0 and m, "a motion of the drawn object")
    assert np.sign(moved) == np.sign(by)
    assert page.locator("#arrow").evaluate("node => node.style.visibility") == "visible"
    page.mouse.up()
    page.locator("#damping").fill("5")
    until(lambda: abs(bright_middle(page) - before) < 0.7, "the return to rest")
    assert page.locator("#arrow").evaluate("node => node.style.visibility") == "hidden"


def test_a_drag_on_the_wall_moves_nothing(page) -> None:
    before = bright_middle(page)
    drag(page, WALL, 150.0)
    time.sleep(1.0)
    assert abs(bright_middle(page) - before) < 0.2
    page.mouse.up()


def test_the_image_is_the_one_that_python_draws(page) -> None:
    one, state = disc(), 0.6
    drawn = pixels(page, [state])
    assert drawn.shape == (192, 256, 3)
    expected = (
        255.0 * one.operating_point.render_images(torch.tensor([[state]], dtype=torch.float64), scale=8)[0]
    )
    assert np.abs(drawn - expected).max() < 4.0
    assert np.abs(drawn - expected).mean() < 0.5


def test_every_control_does_what_it_says(page) -> None:
    def session(code: str):
        return page.evaluate(f"simulation.session.{code}")

    page.locator("#damping").fill("2")
    page.locator("#inertia").fill("1.5")
    page.locator("#stiffness").fill("0.5")
    assert session("law.edits") == {"damping": 2, "inertia": 1.5, "stiffness": 0.5}
    page.locator("#strength").fill("0.5")
    assert session("strength") == pytest.approx(10**0.5)
    page.locator("#radius").fill("0.1")
    assert session("radius") == pytest.approx(0.1 * SIZE[0])
    page.locator("#speed").fill("0.3")
    assert session("speed") == pytest.approx(10**0.3)
    page.locator("#pause").click()
    time.sleep(0.1)
    stood = session("time")
    page.locator("#step").click()
    assert session("time") == pytest.approx(stood + session("dt"))
    page.locator("#frame").fill("30")
    assert session("frame") == 30
    assert session("q") == pytest.approx(page.evaluate("simulation.run.recorded.states[30]"))
    page.locator("#follow").check()
    assert session("following") is True
    page.locator("#input0").evaluate(
        "node => { node.value = node.max; node.dispatchEvent(new Event('input')); }"
    )
    assert session("following") is False
    page.locator("#rest").click()
    assert session("q") == session("run.rest")
    page.locator("#help").click()
    assert page.locator("#card").is_visible()
    page.keyboard.press("Escape")
    page.locator("summary", has_text="View").click()
    page.locator("#show-outline").check()
    assert page.locator("#outline path").count() >= 1
    page.locator("#show-velocity").check()
    until(lambda: page.locator("#velocity line").count() > 3, "arrows of the velocity")
    before = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("#theme").click()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != before


def test_it_begins_in_motion_as_recorded_and_shows_where_to_drag(chromium, path) -> None:
    with opened(chromium, path, moving=True) as page:
        assert page.locator("#follow").is_checked(), "the disc is driven"
        first = page.evaluate("simulation.session.q[0]")
        until(lambda: abs(page.evaluate("simulation.session.q[0]") - first) > 1e-3, "a motion")
        shown = partial(page.locator("#ghost").evaluate, "node => Number(getComputedStyle(node).opacity)")
        assert shown() == 1.0
        drag(page, TOP, 40.0)
        page.mouse.up()
        until(lambda: shown() == 0.0, "no hint")


def test_keys_push_pause_and_let_rest(page) -> None:
    page.locator("#picture").focus()
    page.keyboard.down("ArrowRight")
    until(lambda: page.evaluate("Boolean(simulation.session.grip)"), "a hold")
    moved = until(lambda: abs(q := page.evaluate("simulation.session.q[0]")) > 0.02 and q, "a motion")
    page.keyboard.up("ArrowRight")
    assert page.evaluate("simulation.session.grip") is None
    page.keyboard.press("r")
    page.keyboard.down("ArrowLeft")
    until(lambda: page.evaluate("simulation.session.q[0]") * np.sign(moved) < -0.02, "the other way")
    page.locator("#rest").focus()
    assert page.evaluate("simulation.session.grip") is None, "who looks elsewhere lets go"
    page.keyboard.up("ArrowLeft")
    page.locator("#picture").focus()
    page.keyboard.press("Space")
    assert page.evaluate("simulation.session.paused") is True


def test_numbers_are_told_in_words(page) -> None:
    until(lambda: "q1" in page.locator("#chart-state").get_attribute("aria-label"), "the latest state")
    assert page.locator("#speed").get_attribute("aria-valuetext") == "× 1.0"
    assert page.locator("#chart-books").get_attribute("role") == "img"


def test_f_fills_the_screen_and_colours_follow_the_browser(page) -> None:
    for filled in (True, False):
        page.keyboard.press("f")
        until(
            lambda filled=filled: page.evaluate("Boolean(document.fullscreenElement)") == filled, "a change"
        )
    dark = partial(page.evaluate, "getComputedStyle(document.documentElement).colorScheme === 'dark'")
    page.emulate_media(color_scheme="dark")
    until(dark, "dark colours")
    page.locator("#theme").click()
    until(lambda: not dark(), "colours as chosen")
    page.emulate_media(color_scheme="light")
    page.evaluate("() => new Promise(requestAnimationFrame)")  # of two changes within a frame no page hears
    page.emulate_media(color_scheme="dark")
    until(dark, "dark colours again")


def test_beyond_the_recording_and_after_a_divergence_there_is_a_banner(page) -> None:
    drag(page, TOP, 350.0)
    until(lambda: "Beyond the recording" in page.locator("#banner").inner_text(), "the banner")
    assert "beyond" in page.locator("#picture").get_attribute("class")
    page.mouse.up()
    page.evaluate("simulation.session.v = [1e12]")
    until(lambda: "diverged" in page.locator("#banner").inner_text(), "the stop")
    page.locator("#rest").click()
    until(lambda: page.locator("#banner").inner_text() == "", "the reset")
    assert page.evaluate("simulation.session.stopped") is False


def test_the_page_fits_a_phone(chromium, path) -> None:
    context = chromium.new_context(viewport={"width": 390, "height": 780}, has_touch=True, offline=True)
    tab = context.new_page()
    tab.goto(f"file://{path}")
    until(lambda: tab.evaluate(DRAWN), "the first picture")
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    assert tab.locator("#drawn").bounding_box()["width"] > 330
    context.close()


def test_without_webgl2_the_page_says_so(chromium, path) -> None:
    context = chromium.new_context(offline=True)
    context.add_init_script(NO_WEBGL)
    tab = context.new_page()
    tab.goto(f"file://{path}")
    assert "draws no WebGL2" in tab.locator(".broken").inner_text()
    context.close()
