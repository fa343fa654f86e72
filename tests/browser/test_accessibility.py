"""Pages in a real browser under axe-core's rules: names, roles, contrast, headings and landmarks."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.published_tables import list_published
from lagsplat.report.common.printed_table import format_html
from lagsplat.report.diagnosis.content import ReportContent
from lagsplat.report.diagnosis.html import render_report
from lagsplat.viewer.server.server import ViewerServer
from lagsplat.viewer.static_page.build import save_page
from tests.browser.chromium import PATIENCE_S, browser, until
from tests.browser.disc import disc
from tests.browser.exported import DRAWN
from tests.unit.report.diagnosis import made_content, made_diagnoses

KINDS = made_diagnoses.every_kind()
UNFOLD = "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
SCHEME = "document.documentElement.dataset.mantineColorScheme"
RUN = "axe.run().then((found) => found.violations.map((one) => [one.id, one.nodes.map((node) => node.html)]))"


@pytest.fixture(scope="module")
def axe() -> str:
    """The source of axe-core, named by ``AXE_CORE`` or installed for all; skipped where there is none."""
    place = os.environ.get("AXE_CORE", "")
    if not place and (npm := shutil.which("npm")):
        done = subprocess.run([npm, "root", "--global"], capture_output=True, text=True, check=False)
        place = f"{done.stdout.strip()}/axe-core/axe.min.js"
    if not Path(place).is_file():
        pytest.skip("axe-core is missing: npm install --global axe-core, or AXE_CORE=axe.min.js")
    return Path(place).read_text("utf-8")


@pytest.fixture(scope="module")
def chromium() -> Iterator:
    with browser() as one:
        yield one


def violations(chromium, page: Path, axe: str, *, dark: bool = False, ready: str = "true") -> list:
    """Rules that the page breaks, each with the elements that break it, everything on it unfolded."""
    scheme = "dark" if dark else "light"
    context = chromium.new_context(bypass_csp=True, offline=True, color_scheme=scheme)
    try:
        tab = context.new_page()
        tab.goto(page.as_uri())
        until(lambda: tab.evaluate(ready), "the page")
        tab.evaluate(UNFOLD)
        tab.evaluate(axe)
        return tab.evaluate(RUN)
    finally:
        context.close()


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("kind", ["single", "class", "none", "unknown", "undetermined"])
def test_a_report_is_accessible(chromium, axe: str, tmp_path: Path, kind: str, dark: bool) -> None:
    content = made_content.exhibits() if kind == "single" else ReportContent()
    page = tmp_path / "report.html"
    page.write_text(render_report(KINDS[kind], content), encoding="utf-8")
    assert violations(chromium, page, axe, dark=dark) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_live_view_is_accessible(chromium, axe: str, tmp_path: Path, scheme: str) -> None:
    session, frame = (
        disc("viewer.port=0", "viewer.pictures_hz=6", "viewer.side=48"),
        np.zeros((24, 32, 3), np.uint8),
    )
    live = ViewerServer(session, title="Rocking disc", read_frame=lambda number: frame, folder=tmp_path)
    context = chromium.new_context(bypass_csp=True, color_scheme=scheme)
    try:
        tab = context.new_page()
        tab.set_default_timeout(1000 * PATIENCE_S)
        tab.goto(live.url)
        until(lambda: tab.locator("[role=slider][aria-label^=Brush]").count(), "names of the controls")
        until(lambda: tab.evaluate(SCHEME) == scheme, "the colours that the browser asks for")
        tab.evaluate(axe)
        assert tab.evaluate(RUN) == []
        tab.get_by_role("tab", name="Record").click()
        tab.get_by_role("button", name="Save the session").wait_for()
        assert tab.evaluate(RUN) == []
    finally:
        context.close()
        live.stop()


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_tables_are_accessible(chromium, axe: str, tmp_path: Path, dark: bool) -> None:
    page = tmp_path / "table.html"
    for _, tables in list_published():
        page.write_text(format_html(tables), encoding="utf-8")
        assert violations(chromium, page, axe, dark=dark) == []


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_the_exported_page_is_accessible(chromium, axe: str, tmp_path: Path, dark: bool) -> None:
    page = tmp_path / "push.html"
    save_page(page, disc(), title="Rocking disc", subtitle="A run in miniature")
    assert violations(chromium, page, axe, dark=dark, ready=DRAWN) == []


def test_what_is_not_accessible_is_noticed(chromium, axe: str, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text("<img src='data:image/png;base64,'><p style='color: #ccc'>pale</p>", encoding="utf-8")
    found = {rule for rule, _ in violations(chromium, page, axe)}
    assert {"image-alt", "color-contrast", "document-title"} <= found
