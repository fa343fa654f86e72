"""Pictures of latents, and the points of a body whose Gaussians are known."""

import numpy as np
import pytest
import torch

from lagsplat.diagnose.imaging.rendering import (
    compute_decoding_errors,
    find_body_points,
    read_frames,
    render_latents,
)
from lagsplat.integer_lists import choose_evenly
from lagsplat.report.figures.forces import turn_camera
from tests.unit.evaluate import tiny_run
from tests.unit.forces.solid import turning


@pytest.fixture(scope="module")
def parts():
    film = tiny_run.recording(200, tail=60)
    model = tiny_run.autoencoder()
    return model, tiny_run.chart(model, film), film


def test_the_error_of_a_drawn_frame_is_that_of_the_picture_at_its_own_latents(parts):
    model, chart, film = parts
    errors = compute_decoding_errors(model, chart, film)
    at = choose_evenly(film.n_frames, len(errors))
    mine = np.mean(
        (render_latents(model, chart, chart.latents[at]) - read_frames(film, at)) ** 2, axis=(1, 2, 3)
    )
    np.testing.assert_allclose(errors, mine, rtol=1e-5)
    assert errors.min() > 0.0


def test_a_forecast_that_left_all_bounds_is_still_drawn(parts):
    model, chart, _ = parts
    assert np.isfinite(render_latents(model, chart, np.array([[np.inf, np.nan], [1e30, 0.0]]))).all()


def test_points_move_as_the_gaussians_that_are_drawn(parts):
    model, chart, _ = parts
    with torch.no_grad():
        model.gaussians.coupling[:20] = 0.0  # they stand still
    body = find_body_points(model, chart)
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
        find_body_points(model, chart)
    with torch.no_grad():
        model.gaussians.coupling.copy_(kept)


def test_points_in_space_stand_and_move_where_the_film_shows_them():
    point = turning()
    body = find_body_points(point.autoencoder, point.chart)
    camera = turn_camera(point, 0.0, 0.0)
    places = point.matter.carry(torch.tensor([[0.0], [1e-4]], dtype=torch.float64)).numpy()
    seen = np.stack([camera.project(at) for at in places])
    moved = (seen[1] - seen[0]) / 1e-4
    for place, jacobian in zip(body.rest, body.jacobian[:, 0], strict=True):
        near = np.linalg.norm(seen[0] - place, axis=1).argmin()
        assert np.linalg.norm(seen[0][near] - place) < 2.5
        assert np.linalg.norm(moved[near] - jacobian) < 0.4
