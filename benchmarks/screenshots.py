"""Pictures of what a browser shows: an exported page or the live view under a push, and a report.

Usage: ``python -m benchmarks.screenshots page PAGE.html OUT.png``, or a run in the place of the page,
``live RUN OUT.png``, or ``tutorial OUT.png``, which makes the diagnosis of
``docs/tutorial/first-diagnosis.md`` and shows its report. Needs Debian's ``chromium``, which draws in
software.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parents[1]
LAGSPLAT = str(Path(sys.executable).with_name("lagsplat"))
SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE = {"width": 1440, "height": 900}
PATIENCE_S, SETTLING_S = 120.0, 2.0
LARGEST = """() => [...document.querySelectorAll("canvas")].map((canvas) => canvas.getBoundingClientRect())
    .map(({ x, y, width, height }) => ({ x, y, width, height }))
    .reduce((most, box) => box.width * box.height > most.width * most.height ? box : most)"""


@contextmanager
def open_tab(address: str) -> Iterator[Page]:
    """A tab of a browser without a screen, in light colours."""
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        sys.exit("no browser: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=SOFTWARE)
        tab = browser.new_page(viewport=SIZE, color_scheme="light")  # type: ignore[arg-type]
        tab.set_default_timeout(1000 * PATIENCE_S)
        tab.goto(address)
        yield tab
        browser.close()


def wait_until(holds: Callable[[], object], what: str) -> None:
    """Ask until something holds.

    Raises:
        TimeoutError: it does not within `PATIENCE_S`.
    """
    end = time.monotonic() + PATIENCE_S
    while not holds():
        if time.monotonic() > end:
            raise TimeoutError(f"{what} did not happen within {PATIENCE_S:g} s")
        time.sleep(0.1)


def push_to_the_right(tab: Page, box: dict[str, float]) -> None:
    """Press below the middle of the picture and move to the right, without letting go."""
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.6 * box["height"]
    tab.mouse.move(x, y)
    tab.mouse.down()
    for step in range(1, 11):
        tab.mouse.move(x + 0.012 * step * box["width"], y)
        time.sleep(0.05)
    time.sleep(SETTLING_S)


def show_page(page: str, out: str) -> None:
    """An exported page under a push; a run is exported first."""
    if Path(page).is_dir():
        with tempfile.TemporaryDirectory() as folder:
            exported = f"{folder}/page.html"
            subprocess.run([LAGSPLAT, "export", page, "--html", f"out={exported}"], check=True)
            show_page(exported, out)
        return
    with open_tab(Path(page).resolve().as_uri()) as tab:
        wait_until(lambda: tab.evaluate("Boolean(window.simulation?.frames)"), "the first picture")
        box: Any = tab.locator("#drawn").bounding_box()
        push_to_the_right(tab, box)
        tab.screenshot(path=out)


def show_live(run: str, out: str) -> None:
    """The live view of a run under a push."""
    command = [LAGSPLAT, "view", run, "--no-browser", "viewer.port=0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as server:
        try:
            assert server.stdout is not None
            found = (re.search(r"http://\S+/", line) for line in server.stdout)
            address = next(match.group() for match in found if match)
            with open_tab(address) as tab:
                wait_until(lambda: tab.locator("canvas").count(), "a canvas")
                tab.add_style_tag(content=".mantine-Notification-root { display: none }")
                time.sleep(5 * SETTLING_S)  # the first pictures come with the socket
                push_to_the_right(tab, tab.evaluate(LARGEST))
                tab.screenshot(path=out)
        finally:
            server.terminate()


def show_tutorial(out: str) -> None:
    """The report of the tutorial's diagnosis."""
    text = (ROOT / "docs/tutorial/first-diagnosis.md").read_text("utf-8")
    script, command = (re.search(rf"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("python", "bash"))
    assert script is not None
    assert command is not None
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-c", script[1]], cwd=folder, check=True)
        words = command[1].strip().removeprefix("lagsplat ").split()
        subprocess.run([LAGSPLAT, *words], cwd=folder, check=True)
        with open_tab((Path(folder) / "diagnosis/report.html").as_uri()) as tab:
            time.sleep(SETTLING_S)
            tab.screenshot(path=out)


if __name__ == "__main__":
    {"page": show_page, "live": show_live, "tutorial": show_tutorial}[sys.argv[1]](*sys.argv[2:])
