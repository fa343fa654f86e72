"""The figure of errors over time: every model of the same starts, and none without rollouts."""

import pytest

from lagsplat.report.figures.training_curves import draw_horizon, join_seeds


def found(level: float, starts: tuple[int, ...] = (3, 4)) -> dict:
    rows = {name: [level, 2 * level, 3 * level] for name in ("median", "low", "high", "hold", "mean_frame")}
    return {**rows, "time_s": [0.0, 0.1, 0.2], "starts": list(starts)}


def test_each_group_has_a_panel_with_ours_and_its_band():
    laws = [("least squares", found(1e-3)), ("short", {"reason": "a short clip"})]
    figure = draw_horizon(
        ("ours", found(1e-4)), {"laws": laws, "images": [("theirs", found(1e-2))]}, title="t"
    )
    labels = [[text.get_text() for text in axis.get_legend().get_texts()] for axis in figure.axes]
    grey = ["first frame held", "mean frame"]
    assert labels == [["ours", "least squares", *grey], ["ours", "theirs", *grey]]
    assert [axis.get_title() for axis in figure.axes] == ["laws", "images"]
    for axis in figure.axes:
        assert len(axis.collections) == 1
        assert len({line.get_linestyle() for line in axis.lines[:2]}) == 2


def test_every_model_is_drawn_however_many_there_are():
    laws = [(f"law {i}", found(1e-3)) for i in range(9)]
    (axis,) = draw_horizon(("ours", found(1e-4)), {"laws": laws}, title="t").axes
    assert [line.get_label() for line in axis.lines][1:10] == [name for name, _ in laws]


def test_seeds_are_one_line_and_their_bands_one_band():
    short = {"reason": "a short clip"}
    joined = join_seeds([found(1.0), short, found(2.0), found(6.0)])
    assert joined["median"] == [2.0, 4.0, 6.0]
    assert joined["low"] == [1.0, 2.0, 3.0]
    assert joined["high"] == [6.0, 12.0, 18.0]
    assert join_seeds([short, short]) == short
    title = draw_horizon(("ours", joined), {"laws": [("theirs", found(1.0))]}, title="t").get_suptitle()
    assert "then over seeds" in title
    with pytest.raises(ValueError, match="different frames"):
        join_seeds([found(1.0), found(1.0, (9, 4))])


def test_what_cannot_be_compared_is_refused():
    short = ("short", {"reason": "a short clip"})
    with pytest.raises(ValueError, match="a short clip"):
        draw_horizon(short, {"laws": [short]}, title="t")
    with pytest.raises(ValueError, match="no group"):
        draw_horizon(("ours", found(1.0)), {}, title="t")
    with pytest.raises(ValueError, match="different frames"):
        draw_horizon(("ours", found(1.0)), {"laws": [("theirs", found(1.0, (9, 4)))]}, title="t")
