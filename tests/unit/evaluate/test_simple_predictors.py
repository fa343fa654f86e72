"""Simple predictors: what each does on a motion whose answer is known, and on a run in miniature."""

import json

import numpy as np
import pytest

from lagsplat.evaluate.aggregate import MEAN_IMAGE
from lagsplat.evaluate.simple_predictors import evaluate_simple_predictors, make_neighbour_search
from tests.unit.evaluate import tiny_run
from tests.unit.evaluate.driven_motion import DT_S, simulate, train_on
from tests.unit.evaluate.stand_ins import settings


def test_the_nearest_neighbour_is_nearest_in_velocity_and_in_inputs_too() -> None:
    calm, driven = np.zeros((200, 1)), np.ones((200, 1))
    clips = [simulate(calm, (0.5, 2.0)), simulate(calm, (0.5, -2.0)), simulate(driven, (0.5, 2.0))]
    q = np.concatenate([clip[:, :1] for clip in clips])
    inputs = np.concatenate([calm, calm, driven])
    search = make_neighbour_search(train_on(q, inputs, ((0, 200), (200, 400), (400, 600))))
    for clip, u in zip(clips, (calm, calm, driven), strict=True):
        at = 10
        made = search(clip[at : at + 1, :1], clip[at : at + 1, 1:], u[None, at : at + 30], DT_S)
        np.testing.assert_array_equal(made[0, :, 0], clip[at : at + 30, 0])


@pytest.mark.parametrize(
    ("states", "replayed"), [(6, np.arange(14, 20)), (30, np.minimum(np.arange(17, 47), 19))]
)
def test_a_neighbour_whose_clip_ends_too_soon_is_the_last_choice(states: int, replayed: np.ndarray) -> None:
    time_s = DT_S * np.arange(20.0)[:, None]
    q, v = time_s**2, 2 * time_s
    search = make_neighbour_search(train_on(q, np.zeros((20, 0))))
    made = search(q[17:18], v[17:18], np.zeros((1, states, 0)), DT_S)
    np.testing.assert_array_equal(made[0, :, 0], q[replayed, 0])


def test_all_are_scored_on_a_run_in_miniature() -> None:
    film, model = tiny_run.recording(), tiny_run.autoencoder()
    config = settings(starts=6, floor_frames=40)
    scores = evaluate_simple_predictors(model, tiny_run.chart(model, film), film, config)
    assert json.loads(json.dumps(scores, allow_nan=False)) == scores
    trivial = [MEAN_IMAGE, "Hold", "Nearest neighbour"]
    assert list(scores) == [*trivial, "Linear least squares", "Koopman least squares", "Gaussian process"]
    assert len({str(of["forecast"]["starts"]) for of in scores.values()}) == 1
    mean, hold = scores[MEAN_IMAGE], scores["Hold"]
    assert mean["scores"]["ae_floor"] is None
    images = film.frames / 255.0
    windows = [images[300 + start :][: mean["forecast"]["states"]] for start in mean["forecast"]["starts"]]
    expected = np.mean([(window - images[:300].mean(axis=0)) ** 2 for window in windows])
    assert mean["forecast"]["mse"] == pytest.approx(expected, rel=1e-4)
    assert mean["scores"]["latent_nrmse"] > 0.9
    assert mean["scores"]["image_ratio"] == mean["latent"]["image_mse"] / hold["latent"]["floor"]
    assert hold["latent"]["nrmse"] == pytest.approx(hold["latent"]["nrmse_hold"], rel=0.1)
    assert [scores[name]["dynamics"] for name in list(scores)[3:]] == ["linear", "linear", "nonlinear"]
