"""The figure of errors over time: every model of the same starts, and none without rollouts."""

import pytest

from lagsplat.report.figures.training_curves import draw_horizon


def found(level: float, starts: tuple[int, ...] = (3, 4)) -> dict:
    rows = {name: [level, 2 * level, 3 * level] for name in ("median", "low", "high", "hold", "mean_frame")}
    return {**rows, "time_s": [0.0, 0.1, 0.2], "starts": list(starts)}


def test_each_model_is_a_line_with_a_band():
    models = [("ours", found(1e-4)), ("theirs", found(1e-3)), ("short", {"reason": "a short clip"})]
    axis = draw_horizon(models, title="t").axes[0]
    labels = [text.get_text() for text in axis.get_legend().get_texts()]
    assert labels == ["ours", "theirs", "first frame held", "mean frame"]
    assert len(axis.collections) == 2
    assert len({line.get_linestyle() for line in axis.lines[:2]}) == 2


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ValueError, match="a short clip"):
        draw_horizon([("short", {"reason": "a short clip"})], title="t")
    with pytest.raises(ValueError, match="different frames"):
        draw_horizon([("ours", found(1.0)), ("theirs", found(1.0, (9, 4)))], title="t")
