"""Pictures of every model from one start, and attention maps where there are any."""

import numpy as np
import pytest
import torch

from lagsplat.baselines.model import Baseline
from lagsplat.report.figures.model_comparison import (
    choose_frames,
    compute_attention,
    draw_attention,
    draw_comparison,
    predict_frames,
)
from tests.unit.baselines.problems import architecture
from tests.unit.evaluate.stand_ins import integrate, render, subject, world


def short_subject(**changes):
    held, pictures = world(frames=400, tail=100)
    return subject(held=held, pictures=pictures, **changes)


def test_the_first_picture_is_at_the_given_state_and_moments_end_with_the_clip():
    model = short_subject()
    frames = choose_frames(model)
    assert frames[0] == model.held.longest[0]
    assert frames[-1] < 400
    assert len(frames) == 6
    drawn = predict_frames(model, frames)
    assert np.allclose(drawn[0], render(model.held.encoded[frames[:1]])[0])
    assert np.abs(drawn - model.pictures(frames)).max() < 0.01


def test_a_diverged_state_is_drawn_all_the_same():
    model = short_subject(integrate=lambda *a: np.full_like(integrate(*a), np.nan))
    assert np.isfinite(predict_frames(model, choose_frames(model))).all()


def test_each_model_is_a_row():
    figure = draw_comparison({"ours": short_subject(), "theirs": short_subject()}, title="t")
    assert [figure.axes[i].get_ylabel() for i in (0, 6, 12)] == ["recorded", "ours", "theirs"]


def test_maps_are_drawn_of_models_that_attend():
    torch.manual_seed(0)
    picture = np.random.default_rng(0).uniform(size=(3, 16, 24)).astype(np.float32)
    found = compute_attention("osc", Baseline(architecture()), picture)
    assert found is not None
    assert found.maps.shape == (2, 16, 24)
    assert (found.centres >= 0).all()
    assert (found.centres <= [15, 23]).all()
    assert compute_attention("plain", Baseline(architecture(decoder="deconv")), picture) is None
    figure = draw_attention([found], title="t")
    assert len(figure.axes) == 3
    assert figure.axes[1].get_title().startswith("node 1\nto 0.")
    assert figure.axes[0].get_ylabel() == "osc\n2 nodes"
    with pytest.raises(ValueError, match="add osc_abcd"):
        draw_attention([], title="t")
