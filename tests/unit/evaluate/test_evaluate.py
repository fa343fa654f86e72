"""The whole evaluation on a run in miniature."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.evaluate.evaluate import describe_dynamics, describe_force_reach, evaluate
from tests.unit.evaluate import tiny_run
from tests.unit.evaluate.stand_ins import settings


@pytest.fixture(scope="module")
def parts():
    film, model = tiny_run.recording(), tiny_run.autoencoder()
    return model, tiny_run.chart(model, film), tiny_run.lagrangian(), film


@pytest.fixture(scope="module")
def metrics(parts):
    return evaluate(*parts, settings(starts=6, floor_frames=40))


def test_everything_survives_json(metrics):
    assert json.loads(json.dumps(metrics, allow_nan=False)) == metrics


def test_scores_say_where_they_come_from(metrics, parts):
    assert metrics["recording"] == {"origin": "simulated", "source": "swinging square", "sha256": "0"}
    assert (metrics["d"], metrics["n_held_out"], metrics["skip_frames"]) == (2, 300, 0)
    assert metrics["dynamics"] == "linear"
    assert metrics["scores"]["external_force"] == "anywhere"
    assert metrics["scores"]["ae_floor"] == metrics["floor"]["value"]
    assert metrics["scores"]["rollouts"] == 12 + len(metrics["frequency"]["windows"])


def test_floor_is_the_error_of_the_drawings_of_encoded_frames(metrics, parts):
    model, chart, _, film = parts
    chosen = np.unique(np.linspace(300, 599, 40).round().astype(int))
    images = torch.from_numpy(film.frames[chosen]).permute(0, 3, 1, 2).float() / 255
    with torch.no_grad():
        drawn = model.decode(torch.from_numpy(chart.to_raw(chart.latents[chosen])).float()).clamp(0, 1)
        expected = float(((drawn - images) ** 2).mean())
    assert metrics["floor"]["value"] == pytest.approx(expected, rel=1e-4)


def test_free_motion_and_the_law_are_measured_in_seconds(metrics):
    assert metrics["frequency"]["encoded_hz"] == pytest.approx(tiny_run.FREQUENCY_HZ, rel=0.05)
    assert metrics["frequency"]["rollout_hz"] == pytest.approx(tiny_run.FREQUENCY_HZ, rel=0.03)
    assert metrics["latent"]["period_s"] == pytest.approx(1 / metrics["frequency"]["encoded_hz"])
    for mode in metrics["linear_modes"]:
        assert mode["frequency_hz"] == pytest.approx(tiny_run.FREQUENCY_HZ, rel=0.01)
        assert mode["rate_per_s"] == pytest.approx(tiny_run.RATE_PER_S, rel=0.05)


def test_repeats_exactly(metrics, parts):
    again = evaluate(*parts, settings(starts=6, floor_frames=40))
    assert {**again, "wall_time_s": 0} == {**metrics, "wall_time_s": 0}


def test_without_a_free_window_the_reason_stands_in_the_result(parts):
    model, chart, law, film = parts
    busy = np.random.default_rng(0).uniform(size=chart.inputs.shape)
    metrics = evaluate(model, replace(chart, inputs=busy), law, film, settings(starts=3, floor_frames=5))
    assert metrics["scores"]["frequency_error"] is None
    assert metrics["scores"]["latent_nrmse"] is None
    assert "evaluate.period_s" in metrics["latent"]["reason"]
    imposed = settings(starts=3, floor_frames=5, period_s=0.5)
    metrics = evaluate(model, replace(chart, inputs=busy), law, film, imposed)
    assert metrics["latent"]["period_from"] == "evaluate.period_s"
    assert metrics["scores"]["latent_nrmse"] > 0


def test_parts_of_different_runs_are_refused(parts):
    model, chart, law, film = parts
    with pytest.raises(ValueError, match="600 latents and the recording 599"):
        evaluate(model, chart, law, film.part(0, 599), settings())
    with pytest.raises(ValueError, match="another autoencoder"):
        evaluate(model, replace(chart, latents=chart.latents + 0.1), law, film, settings())


def test_too_long_a_skip_is_explained(parts):
    with pytest.raises(ValueError, match=r"evaluate\.skip_s=8\.0 takes 480"):
        evaluate(*parts, settings(skip_s=8.0))


def test_a_decoder_that_cannot_move_takes_no_force(parts):
    model = tiny_run.autoencoder()
    with torch.no_grad():
        model.gaussians.coupling.zero_()
    assert describe_force_reach(model) == "none"


@pytest.mark.parametrize(
    ("mass", "potential", "expected"),
    [
        ("constant", "quadratic", "linear"),
        ("learned", "quadratic", "nonlinear"),
        ("constant", "invex", "nonlinear, constant mass"),
        ("induced", "invex", "nonlinear, induced mass"),
    ],
)
def test_kind_of_dynamics_is_read_off_the_law(mass, potential, expected):
    law = tiny_run.lagrangian()
    law.form = replace(law.form, mass=mass, potential=potential)
    assert describe_dynamics(law) == expected
