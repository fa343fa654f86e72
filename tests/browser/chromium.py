"""A real headless browser for tests, or the reason why there is none."""

import base64
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome")
SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PATIENCE_S = 150.0
NO_WEBGL = """
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...rest);
};
"""
"""A script that makes a browser one without WebGL."""


@contextmanager
def browser() -> Iterator:
    """Chromium without a screen, drawing in software; the test is skipped where there is none."""
    path = next((found for name in NAMES if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip(f"no browser on this machine ({', '.join(NAMES)}); apt-get install chromium")
    api = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    with api.sync_playwright() as playwright:
        try:
            chromium = playwright.chromium.launch(executable_path=path, args=SOFTWARE)
        except api.Error as error:
            pytest.skip(f"{path} does not start on this machine: {str(error).splitlines()[0]}")
        try:
            yield chromium
        finally:
            chromium.close()


def seen(page, clip: dict[str, float] | None = None) -> np.ndarray:
    """What the page shows, RGB (H, W, 3), in all or within ``clip``; does not wait for the page to be
    quiet."""
    settings = {"format": "png"} | ({} if clip is None else {"clip": {**clip, "scale": 1}})
    page.bring_to_front()  # a page behind another is drawn once a second
    protocol = page.context.new_cdp_session(page)
    data = protocol.send("Page.captureScreenshot", settings)["data"]
    protocol.detach()
    return np.asarray(Image.open(BytesIO(base64.b64decode(data))).convert("RGB")).astype(np.float64)


def until(holds: Callable[[], object], what: str, patience_s: float = PATIENCE_S) -> object:
    """Wait for something to become true; it is returned."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        if found := holds():
            return found
        time.sleep(0.05)
    raise AssertionError(f"{what} did not happen within {patience_s:g} s")
