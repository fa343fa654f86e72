"""Pictures of latents, and the points of a body whose Gaussians are known."""

import numpy as np
import pytest
import torch

from lagsplat.diagnose.pictures import body_points, drawing_errors, drawn, evenly, measured
from tests.unit.evaluate import tiny_run


@pytest.fixture(scope="module")
def parts():
    film = tiny_run.recording(200, tail=60)
    model = tiny_run.autoencoder()
    return model, tiny_run.chart(model, film), film


def test_frames_are_chosen_evenly_with_both_ends():
    np.testing.assert_array_equal(evenly(5, 9), np.arange(5))
    chosen = evenly(1000, 11)
    assert (chosen[0], chosen[-1], len(chosen)) == (0, 999, 11)


def test_the_error_of_a_drawn_frame_is_that_of_the_picture_at_its_own_latents(parts):
    model, chart, film = parts
    errors = drawing_errors(model, chart, film)
    at = evenly(film.n_frames, len(errors))
    mine = np.mean((drawn(model, chart, chart.latents[at]) - measured(film, at)) ** 2, axis=(1, 2, 3))
    np.testing.assert_allclose(errors, mine, rtol=1e-5)
    assert errors.min() > 0.0


def test_a_forecast_that_left_all_bounds_is_still_drawn(parts):
    model, chart, _ = parts
    assert np.isfinite(drawn(model, chart, np.array([[np.inf, np.nan], [1e30, 0.0]]))).all()


def test_points_move_as_the_gaussians_that_are_drawn(parts):
    model, chart, _ = parts
    with torch.no_grad():
        model.gaussians.coupling[:20] = 0.0  # they stand still
    body = body_points(model, chart)
    assert len(body.rest) <= 10
    q = np.array([[0.0, 0.0], [0.7, -0.3]])
    with torch.no_grad():
        means = model.gaussians.condition(torch.as_tensor(chart.to_raw(q), dtype=torch.float32)).means
    drawn_at = means.double().numpy()
    for rest, moved in zip(body.at(q)[0], body.at(q)[1], strict=True):
        nearest = np.argmin(np.linalg.norm(drawn_at[0] - rest, axis=1))
        np.testing.assert_allclose(drawn_at[0, nearest], rest, atol=1e-3)
        np.testing.assert_allclose(drawn_at[1, nearest], moved, atol=1e-3)


def test_a_run_in_which_nothing_moves_is_refused(parts):
    model, chart, _ = parts
    with torch.no_grad():
        kept = model.gaussians.coupling.clone()
        model.gaussians.coupling.zero_()
    with pytest.raises(ValueError, match="no visible Gaussian"):
        body_points(model, chart)
    with torch.no_grad():
        model.gaussians.coupling.copy_(kept)
