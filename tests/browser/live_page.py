"""What tests do to the live page in a browser: open it, drag on it, look at it."""

import time

import numpy as np

from tests.browser.chromium import PATIENCE_S, seen, until

LARGEST = """() => {
  const boxes = [...document.querySelectorAll("canvas")].map((canvas) =>
  canvas.getBoundingClientRect().toJSON()); const { x, y, width, height } = boxes.sort((a, b) => b.width *
  b.height - a.width * a.height)[0] ?? {}; return width > 50 && height > 50 ? { x, y, width, height } :
  null;
}"""
VIEW = {"width": 760, "height": 520}  # smaller, and a notice of viser covers the object


def opened(chromium, live):
    """A tab in which the first picture is seen."""
    tab = chromium.new_page(viewport=VIEW, color_scheme="dark")  # beside white, the object would be lost
    tab.set_default_timeout(1000 * PATIENCE_S)
    tab.goto(live.url)
    until(lambda: len(live.server.get_clients()) > 0, "a connection")
    scheme = tab.locator("html")
    until(lambda: scheme.get_attribute("data-mantine-color-scheme") == "dark", "dark colours")
    until(lambda: canvas_of(tab) is not None and ink_of(tab).sum() > 1e4, "the first picture")
    return tab


def canvas_of(page) -> dict[str, float] | None:
    """Where the scene is drawn: the largest canvas, once it has been laid out."""
    return page.evaluate(LARGEST)


def ink_of(page) -> np.ndarray:
    """How bright each column of the scene is where it is nearly white."""
    return np.clip(seen(page, canvas_of(page)).min(2) - 150.0, 0.0, None).sum(0)


def middle(page) -> float:
    """The column in the middle of what is nearly white."""
    ink = ink_of(page)
    return float((ink * np.arange(len(ink))).sum() / ink.sum())


def drag_from(page, x: float, y: float, by: float) -> None:
    """Press at a place of the page and move to the right, without letting go."""
    page.mouse.move(x, y)
    page.mouse.down()
    for i in range(1, 9):
        page.mouse.move(x + by * i / 8, y)
        time.sleep(0.05)


def settled(page) -> float:
    """The middle once two looks in a row agree: a tab's first picture may be of a motion just ended."""
    looks = [middle(page)]

    def steady() -> bool:
        time.sleep(0.5)
        looks.append(middle(page))
        return abs(looks[-1] - looks[-2]) < 0.2

    until(steady, "a picture that stands still")
    return looks[-1]
