"""One page, whole in itself, for every verdict; what comes from outside cannot become markup."""

import base64
import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import pytest

from lagsplat.diagnose.core.result import Interval
from lagsplat.report.common.formatting import format_percent
from lagsplat.report.diagnosis.content import ReportContent
from lagsplat.report.diagnosis.html import render_report
from lagsplat.report.diagnosis.summary import write_summary
from tests.unit.report.diagnosis import made_content, made_diagnoses

KINDS = made_diagnoses.every_kind()
VOID = {"meta", "link", "img", "br", "hr", "input"}


class Page(HTMLParser):
    """Balance, names and the text of paragraphs of a page."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.paragraphs, self.sources, self.tags = [], [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        found = dict(attrs)
        self.ids += [found["id"]] if "id" in found else []
        self.sources += [value for name, value in attrs if name in ("src", "href", "xlink:href")]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "p":
            self.paragraphs.append("")

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "p":
            self.paragraphs[-1] += data


OF_FILMS = re.compile(
    r"\b(cameras?|frames?|films?|filmed|videos?|pictures?|images?|exposure)\b", re.IGNORECASE
)


@cache
def page_of(kind):
    return render_report(KINDS[kind], ReportContent())


@pytest.fixture
def undrawn(monkeypatch):
    """Figures take most of the time of a page, and are the same whatever is said around them."""
    monkeypatch.setattr("lagsplat.report.diagnosis.html.encode_svg_uri", lambda figure: "data:image/svg+xml,")


@pytest.fixture(scope="module")
def full():
    return render_report(KINDS["single"], made_content.exhibits())


def test_the_page_is_whole_in_itself(full):
    page = Page(full)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert all(source.startswith(("#", "data:image/")) for source in page.sources)
    outside = re.findall(r'(?:src|href)="(?!#|data:)[^"]*|@import|url\((?!#)', full)
    assert outside == []
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert "http" not in re.sub(r'src="data:[^"]*"', "", full)
    for data in re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', full):
        # Names of XML dialects are no addresses that a reader would fetch.
        rest = re.sub(r'xmlns(?::\w+)?="[^"]*"|<!DOCTYPE[^>]*>', "", base64.b64decode(data).decode())
        assert "http" not in rest


def plain(text):
    bare = re.sub(r"<style>.*?</style>|<[^>]+>", " ", text, flags=re.DOTALL)
    return bare.replace("\N{NO-BREAK SPACE}", " ")


def test_the_page_has_the_verdict_in_words(full):
    said = [paragraph.replace("\N{NO-BREAK SPACE}", " ") for paragraph in Page(full).paragraphs]
    assert write_summary(KINDS["single"]).replace("\N{NO-BREAK SPACE}", " ") in said


def test_the_answer_comes_first_and_details_are_folded(full):
    parts = ("<h1>Coulomb friction at q1</h1>", "Probability 0.99", *QUESTIONS, 'id="waterfall"')
    parts += ("What it rests on", 'id="rollouts"', "<details>", "Checks of the data", "All candidates")
    places = [full.index(part) for part in (*parts, "How to reproduce this</h2>")]
    assert places == sorted(places)
    folded = full[full.index("<details>") :]
    assert folded.count("<details>") == 6
    assert "<section" not in folded
    assert "Record next" not in full
    undecided = page_of("undecided")
    assert undecided.index("Do now") < undecided.index("Record next") < undecided.index("What it rests on")


QUESTIONS = tuple(f"<dt>{question}</dt>" for question in ("Size", "Gap", "Where", "Shrinks", "Do now"))


@pytest.mark.parametrize(
    ("kind", "does"),
    [
        ("single", "Add Coulomb friction to the simulation, or look after the bearings and seals."),
        ("none", "Keep the simulation as it is."),
        ("unknown", "before anything is added; then, record a decay down to rest, or slow reversals."),
        ("undetermined", "Add nothing yet, and record a decay down to rest, or slow reversals."),
        ("class", "To tell them apart, record a tenth of the samples slower than the Stribeck velocity."),
    ],
)
def test_every_verdict_says_what_to_do_now(kind, does, undrawn):
    assert does in " ".join(plain(page_of(kind)).partition("Do now")[2].split())


def test_errors_stand_on_one_scale_and_no_share_closes_more_than_all(undrawn):
    made = KINDS["single"]
    closed = replace(made.candidates[0], closure=Interval(1.02, 0.9, 1.1))
    text = plain(render_report(replace(made, candidates=(closed, *made.candidates[1:])), ReportContent()))
    gap = made.gap
    for share, end in ((1.02, " ["), (1.1, ","), (0.9, "]")):
        assert f"{format_percent(gap.before - share * (gap.before - gap.floor))}{end}" in text
    assert not re.search(r"\b10[1-9] %|closes \d", text)


def test_what_was_not_fitted_says_so(undrawn):
    made = KINDS["single"]
    bare = replace(made.candidates[-1], name="creep", misfit=None, closure=None, probability=0.001)
    page = render_report(replace(made, candidates=(*made.candidates, bare)), ReportContent())
    assert page.count('<td colspan="4">not fitted</td>') == 1


def test_no_more_than_three_recordings_are_asked_for(undrawn):
    planned = made_diagnoses.planned()
    many = replace(planned, suggestions=planned.suggestions * 3)
    page = render_report(replace(KINDS["class"], next_experiments=many), ReportContent())
    assert page[page.index("Record next") : page.index("What it rests on")].count("<li>") == 3


def test_everything_is_told(full):
    for part in (
        "lagsplat diagnose sim=sim.csv real=swing.csv",
        "0" * 40,
        "scipy 1.17.1",
        "the motion jumps by 0.3 at 10 s",
        "0.771 to 0.832",
        "input lag",
        "data:image/webp",
    ):
        assert part in full
    assert ", gsplat" not in full


@pytest.mark.parametrize("kind", KINDS)
def test_every_verdict_has_a_page(kind, undrawn):
    page = page_of(kind)
    assert Page(page).open == []
    visible = re.sub(r'src="[^"]*"|<style>.*?</style>', "", page, flags=re.DOTALL)
    assert not re.search(r"\bNone\b|\bnan\b|\binf\b|Undefined|\{\{|\{%", visible)
    assert "0.99" not in visible or not re.search(r"0\.99\d|\b1\.00\b", visible)
    assert "Not computed" in visible


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_without_images_says_nothing_of_them(kind, undrawn):
    page = re.sub(r"<style>.*?</style>|<[^>]+>", " ", page_of(kind), flags=re.DOTALL)
    assert OF_FILMS.findall(page) == []


def test_noise_is_told_by_coordinate(full, undrawn):
    assert "<b>0.011, 0.0098</b>noise of each coordinate" in full
    made = replace(KINDS["single"], checks={"noise": {"sigma": [0.25, 0.5], "ar1": [0.1, 0.2]}, "blocks": 16})
    page = render_report(made, ReportContent())
    assert "<b>0.25, 0.50</b>" in page
    assert "The quality of the data was not checked." in page


def test_an_unknown_place_is_said(undrawn):
    page = page_of("undetermined")
    assert "level, coordinates, time, frequency, state region, components" in page
    assert "the recording lasts only 1.4 periods" in page


EVIL = '<script>alert("x")</script>&<img src=x onerror=y>{{ 7 * 7 }}$\\frac$'


def test_text_from_data_is_never_markup():
    made = KINDS["push"]
    first, *rest = made.candidates
    unit = replace(first.parameters["times"], unit=EVIL)
    wrong = replace(first, coordinate=EVIL, parameters={EVIL: unit})
    finding = {"level": EVIL, "source": EVIL, "what": EVIL, "why": EVIL, "remedy": EVIL}
    row = {"effect": EVIL, "excited": "no", "smallest": 0.5, "record": EVIL}
    bad = replace(
        made,
        candidates=(wrong, *rest),
        excitation=(EVIL,),
        warnings=(EVIL + "1",),
        blocks=tuple(replace(one, file=EVIL) for one in made.blocks),
        checks={EVIL: EVIL, "findings": [finding], "excitation": [row], "note": EVIL},
        q_names=("q0", EVIL),
        where={"level": "dynamics", "coordinates": {EVIL: 0.9, "q0": 0.1}},
    )
    exhibits = ReportContent(command=EVIL, stamp={"commit": EVIL, "versions": {EVIL: EVIL}})
    text = render_report(bad, exhibits)
    assert Page(text).open == []
    assert "<script" not in text
    assert "<img src=x" not in text
    assert "49" not in re.sub(r'src="[^"]*"', "", text)


def test_numbers_of_the_fits_stand_at_the_end_and_not_among_the_data(undrawn):
    made = KINDS["single"]
    fitted = {"misfit_none": 75.0, "answers": {"half the noise": "coulomb_friction"}}
    page = render_report(replace(made, checks={**made.checks, **fitted}), made_content.exhibits())
    beginning, end = page.split("<h2>How to reproduce this</h2>", 1)
    assert "misfit none" not in beginning
    assert "<td>misfit none</td><td>75</td>" in end
    assert "half the noise: coulomb_friction" in end


def test_the_page_says_what_to_do_next_and_which_file_disagrees(undrawn):
    files, planned = made_diagnoses.several_files(), made_diagnoses.planned()
    text = render_report(replace(KINDS["single"], files=files, next_experiments=planned), ReportContent())
    assert "Record next: Coulomb friction (q1) or viscous damping (q1)?" in text
    assert "Record a chirp of torque, for 12 s." in text
    assert text.count("next_experiment_1.csv") == 2  # in the summary and in the list
    assert "next_experiment_2.csv" not in text
    assert files[2].disagrees in text
    Page(text)
    nothing = replace(planned, suggestions=(), reason="No experiment separates them")
    without = render_report(replace(KINDS["single"], next_experiments=nothing), ReportContent())
    assert "No experiment separates them." in without
    assert "Record next" not in without


def test_one_file_has_no_table_of_files():
    assert "File by file" not in page_of("single")


def test_the_moves_of_a_refit_stand_with_interval_and_tolerance(undrawn):
    move = {
        "name": "damping rate",
        "value": 0.1234,
        "low": 0.11,
        "high": 0.14,
        "tolerance": 0.05,
        "unit": "1/s",
    }
    made = KINDS["none"]
    page = render_report(replace(made, checks={**made.checks, "refit": [move]}), ReportContent())
    row = page[page.index("damping rate (1/s)") :]
    assert re.findall(r"<td[^>]*>([^<]*)</td>", row)[:3] == ["0.123", "0.110 to 0.140", "± 0.050"]
