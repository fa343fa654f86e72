"""Figures of every verdict: drawn without a warning, labelled, and left out where nothing was computed."""

import base64
import re
from dataclasses import replace
from xml.etree import ElementTree

import cv2
import matplotlib as mpl
import numpy as np
import pytest

from lagsplat.diagnose.core.result import Interval
from lagsplat.report.common.formatting import format_percent
from lagsplat.report.common.style import encode_svg_uri, save_figure
from lagsplat.report.diagnosis.content import ReportContent
from lagsplat.report.diagnosis.figure_hypotheses import draw_separability, draw_waterfall
from lagsplat.report.diagnosis.figure_residual import draw_forecast_comparison, draw_time_strip
from lagsplat.report.diagnosis.figure_state import MAX_SIDE_PX, draw_image_maps, encode_video_uri
from lagsplat.report.diagnosis.figures import draw_diagnosis_figures
from tests.unit.report.diagnosis import made_content, made_diagnoses

KINDS = made_diagnoses.every_kind()


def texts(figure) -> str:
    return " | ".join(text.get_text() for text in figure.findobj(mpl.text.Text))


@pytest.fixture(scope="module")
def drawn():
    return {one.key: one.figure for one in draw_diagnosis_figures(KINDS["single"], made_content.exhibits())}


def test_everything_is_drawn_where_everything_is_there(drawn):
    assert [key for key, figure in drawn.items() if figure is None] == []


def test_no_global_style_moves(tmp_path):
    before = dict(mpl.rcParams)
    figure = draw_waterfall(KINDS["single"])
    save_figure(tmp_path / "a.pdf", figure)
    encode_svg_uri(figure)
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize("kind", ["undetermined", "push", "none"])
def test_what_is_missing_is_left_out(kind):
    absent = {one.key for one in draw_diagnosis_figures(KINDS[kind], ReportContent()) if one.figure is None}
    assert absent >= {"ladder", "picture", "separability", "profiles", "fingerprint"}
    assert ("waterfall" in absent) == (KINDS[kind].gap is None)
    assert ("rollouts" in absent) == (not KINDS[kind].blocks)
    assert ("spectrum" in absent) == (kind != "none")
    assert "posterior" not in absent


def test_the_waterfall_goes_from_before_to_after(drawn):
    gap = KINDS["single"].gap
    words = texts(drawn["waterfall"])
    for value in (gap.before, gap.after):
        assert format_percent(value) in words
    assert f"floor {format_percent(gap.floor)}" in words
    # Bars that float: where one ends the next begins, and the last stands on the ground.
    bars = [bar for box in drawn["waterfall"].axes[0].containers for bar in box]
    assert bars[0].get_height() == pytest.approx(gap.before)
    level = gap.before
    for bar in bars[1:-1]:
        assert bar.get_y() == pytest.approx(level)
        level += bar.get_height()
    assert bars[-1].get_height() == pytest.approx(level) == pytest.approx(gap.after)


def test_the_waterfall_bears_numbers_that_are_missing():
    gap = KINDS["single"].gap
    bare = replace(gap, refit=float("nan"), floor=float("nan"), closure=Interval(None, None, None))
    words = texts(draw_waterfall(replace(KINDS["single"], gap=bare)))
    assert "floor" not in words
    assert "nan" not in words


def test_the_posterior_names_every_candidate(drawn):
    words = texts(drawn["posterior"])
    for name in ("Coulomb friction at q1", "none", "unknown", "0.99", "< 0.01"):
        assert name in words
    assert "1.00" not in words


def test_the_strip_shows_the_coordinate_with_the_gap(drawn):
    words = texts(drawn["time"])
    assert "q1/s²" in words
    assert "time in swing.csv (s)" in words
    assert "40 %" in words
    assert draw_time_strip(KINDS["undetermined"]) is None


def test_a_forecast_that_runs_away_does_not_flatten_the_motion():
    made = KINDS["push"]
    wild = tuple(
        replace(one, sim=1e6 * one.sim, augmented=np.full_like(one.sim, np.nan)) for one in made.blocks
    )
    strip = draw_time_strip(replace(made, blocks=wild))
    low, high = strip.axes[0].get_ylim()
    assert high - low < 10.0
    pairs = draw_forecast_comparison(replace(made, blocks=wild))
    assert "not finite" not in texts(pairs)


def test_pairs_stand_on_one_scale(drawn):
    axes = np.array(drawn["rollouts"].axes).reshape(-1, 2)
    for left, right in axes:
        assert left.get_ylim() == right.get_ylim()
    off = [float(re.search(r"off by ([\d.]+)", texts_of(axis)).group(1)) for axis in axes[:, 0]]
    assert off == sorted(off, reverse=True)


def texts_of(axis):
    return axis.get_title(loc="right")


def test_the_profile_follows_what_the_residual_varies_with(drawn):
    """Dry friction is a step in velocity, and flat along position."""
    axis = next(one for one in drawn["state"].axes if one.get_legend())
    assert axis.get_xlabel() == "q1 rate (1/s)"
    sim = next(one for one in axis.patches if one.get_label() == "sim")
    values = sim.get_data().values
    assert values[0] > 0.5
    assert values[-1] < -0.5


def test_pairs_below_three_nats_are_framed(drawn):
    exhibits = made_content.exhibits()
    off_diagonal = exhibits.separability.nats[~np.eye(5, dtype=bool)]
    frames = [one for one in drawn["separability"].axes[0].patches if isinstance(one, mpl.patches.Rectangle)]
    assert len(frames) == np.sum(off_diagonal < 3.0)
    assert draw_separability(ReportContent()) is None


def test_a_force_that_cannot_be_placed_is_not_drawn():
    placed, vague = (
        draw_image_maps(ReportContent(image_force=made_content.picture_force(localisable=there)))
        for there in (True, False)
    )
    assert any(isinstance(one, mpl.quiver.Quiver) for one in placed.axes[1].get_children())
    assert not any(isinstance(one, mpl.quiver.Quiver) for one in vague.axes[1].get_children())
    assert "not localisable" in texts(vague)


def test_a_film_comes_back(tmp_path):
    film = made_content.film(9)
    head, _, data = encode_video_uri(film).partition(",")
    assert head == "data:image/webp;base64"
    (tmp_path / "a.webp").write_bytes(base64.b64decode(data))
    read, animation = cv2.imreadanimation(str(tmp_path / "a.webp"))
    assert read
    assert len(animation.frames) == 9
    height, width = animation.frames[0].shape[:2]
    assert (height, width // 3) == (48 * (MAX_SIDE_PX // 64), 64 * (MAX_SIDE_PX // 64) + 2)
    # The sim's pictures differ from the measured ones, those with the effects hardly.
    first = animation.frames[0][..., :3].astype(float)
    third = (width - 8) // 3
    real, sim, augmented = (first[:, at : at + third] for at in (0, third + 4, 2 * third + 8))
    assert np.abs(sim - real).mean() > 3.0 * np.abs(augmented - real).mean()
    with pytest.raises(ValueError, match="alike"):
        encode_video_uri(replace(film, sim=film.sim[:5]))


def test_long_films_are_thinned():
    film = made_content.film(400)
    small = replace(
        film, real=film.real[:, ::8, ::8], sim=film.sim[:, ::8, ::8], augmented=film.augmented[:, ::8, ::8]
    )
    assert len(encode_video_uri(small)) < 3_000_000


def test_figures_for_a_page_are_whole_and_the_same_each_time(drawn):
    first, again = (encode_svg_uri(drawn["ladder"]) for _ in range(2))
    assert first == again
    kind, _, data = first.partition(",")
    assert kind == "data:image/svg+xml;base64"
    text = base64.b64decode(data).decode()
    assert ElementTree.fromstring(text).attrib["viewBox"]
    known = set(re.findall(r'\bid="([^"]+)"', text))
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', text)) <= known
