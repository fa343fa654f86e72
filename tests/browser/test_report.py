"""The report of a diagnosis in a real browser: its answer is on the first screen, and it fits a phone."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from lagsplat.report.diagnosis.content import ReportContent
from lagsplat.report.diagnosis.html import render_report
from tests.browser.chromium import browser
from tests.unit.report.diagnosis import made_diagnoses

KINDS = made_diagnoses.every_kind()
LOWEST = """(name) => Math.max(
  ...Array.from(document.querySelectorAll(name), (one) => one.getBoundingClientRect().bottom))"""


@pytest.fixture(scope="module")
def chromium() -> Iterator:
    with browser() as one:
        yield one


@pytest.mark.parametrize("kind", [kind for kind, made in KINDS.items() if made.gap is not None])
def test_the_answer_is_on_the_first_screen(chromium, tmp_path: Path, kind: str) -> None:
    made = replace(KINDS[kind], next_experiments=made_diagnoses.planned())
    path = tmp_path / "report.html"
    path.write_text(render_report(made, ReportContent()), encoding="utf-8")
    page = chromium.new_page(viewport={"width": 1440, "height": 900})
    page.goto(path.as_uri())
    assert 0 < page.evaluate(LOWEST, "dl") < 900
    assert 0 < page.evaluate(LOWEST, "#waterfall img") < 900
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.close()
