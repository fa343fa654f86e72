"""Exported pages in a browser, from disk and with the network off: to open, to drag on, to read pixels of."""

import base64
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from tests.browser.chromium import until
from tests.browser.disc import SIZE

# the page forbids itself to evaluate text, so that a condition is asked for from outside
DRAWN = "Boolean(window.simulation?.frames)"
PIXELS = """(q) => {
  const { session, splats } = simulation;
  Object.assign(session, { paused: true, q });
  splats.resize(256);
  splats.draw(q);
  const { gl, canvas } = splats;
  const bytes = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  let text = "";
  for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  return [canvas.height, canvas.width, btoa(text)];
}"""
VIEW = {"width": 800, "height": 640}


@contextmanager
def opened(chromium, path, *, moving: bool = False) -> Iterator:
    """A page that has drawn its first picture, and that meets no error until it is closed.

    It is at rest, unless it may be ``moving`` as it begins.
    """
    context = chromium.new_context(
        viewport=VIEW, offline=True, reduced_motion="no-preference" if moving else "reduce"
    )
    errors: list[str] = []
    tab = context.new_page()
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(f"file://{path}")
    until(lambda: tab.evaluate(DRAWN), "the first picture")
    yield tab
    context.close()
    assert errors == []


def at(page, place: tuple[float, float]) -> tuple[float, float]:
    """Where a place of the picture [px of the training resolution] is on the screen, which shows it."""
    drawn = page.locator("#drawn")
    drawn.evaluate("node => node.scrollIntoView({ block: 'center', behavior: 'instant' })")
    box = drawn.bounding_box()
    return box["x"] + place[0] / SIZE[0] * box["width"], box["y"] + place[1] / SIZE[1] * box["height"]


def drag(page, place: tuple[float, float], by: float) -> None:
    """Press on a place of the picture, and move to the right."""
    x, y = at(page, place)
    page.mouse.move(x, y)
    page.mouse.down()
    for i in range(1, 6):
        page.mouse.move(x + by * i / 5, y)


def pixels(page, q: list[float]) -> np.ndarray:
    """The picture that the page draws at a state, 256 pixels wide (H, W, 3), 0 to 255."""
    height, width, data = page.evaluate(PIXELS, q)
    values = np.frombuffer(base64.b64decode(data), np.uint8).astype(np.float64)
    return values.reshape(height, width, 4)[::-1, :, :3]
