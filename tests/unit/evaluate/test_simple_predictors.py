"""Simple predictors: what each does on a motion whose answer is known, and on a run in miniature."""

import json

import numpy as np
import pytest
import scipy.linalg

from lagsplat.evaluate.aggregate import MEAN_IMAGE
from lagsplat.evaluate.protocol import STENCILS, HeldOut
from lagsplat.evaluate.simple_predictors import (
    evaluate_simple_predictors,
    fit_linear_law,
    make_neighbour_search,
)
from tests.unit.evaluate import tiny_run
from tests.unit.evaluate.stand_ins import settings

DT_S = 0.02
OSCILLATOR = np.array([[0.0, 1.0, 0.0], [-30.0, -0.4, 30.0], [0.0, 0.0, 0.0]])  # of (q, v, u)


def simulate(inputs: np.ndarray, state: tuple[float, float]) -> np.ndarray:
    """States (T, 2) of a damped oscillator whose input is held over each step."""
    step = scipy.linalg.expm(DT_S * OSCILLATOR)[:2]
    states = [np.array(state)]
    for u in inputs[:-1, 0]:
        states.append(step @ [*states[-1], u])
    return np.array(states)


def train_on(
    q: np.ndarray, inputs: np.ndarray, segments: tuple[tuple[int, int], ...] | None = None
) -> HeldOut:
    return HeldOut(
        encoded=q,
        latents=q,
        forcing=inputs,
        inputs=inputs,
        segments=segments or ((0, len(q)),),
        metric=np.eye(q.shape[1]),
        dt_s=DT_S,
        skip=0,
        stencil=STENCILS["central"],
    )


def test_the_linear_law_forecasts_a_linear_motion_under_new_inputs() -> None:
    rng = np.random.default_rng(0)
    pushes = [np.repeat(rng.normal(size=40), 25)[:, None] for _ in range(2)]
    known, new = (simulate(u, (1.0, 0.0)) for u in pushes)
    integrate = fit_linear_law(train_on(known[:, :1], pushes[0]))
    after = 200
    made = integrate(new[after : after + 1, :1], new[after : after + 1, 1:], pushes[1][None, after:300], DT_S)
    assert made.shape == (1, 100, 1)
    # velocities of the fit are differences, so it is not exact
    assert np.abs(made[0, :, 0] - new[after:300, 0]).max() < 0.03 * np.abs(new[:, 0]).max()


def test_a_law_that_grows_ends_not_finite_rather_than_in_an_error() -> None:
    q = np.exp(0.3 * np.arange(100.0))[:, None]
    made = fit_linear_law(train_on(q, np.zeros((100, 0))))(q[:2], 15 * q[:2], np.zeros((2, 4000, 0)), DT_S)
    assert not np.isfinite(made[:, -1]).any()
    assert np.isfinite(made[:, 1]).all()


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


def test_a_training_part_without_a_clip_long_enough_is_refused() -> None:
    q = np.zeros((6, 1))
    with pytest.raises(ValueError, match="no training clip has 4 frames; use a longer recording"):
        fit_linear_law(train_on(q, np.zeros((6, 0)), ((0, 3), (3, 6))))


def test_all_are_scored_on_a_run_in_miniature() -> None:
    film, model = tiny_run.recording(), tiny_run.autoencoder()
    config = settings(starts=6, floor_frames=40)
    scores = evaluate_simple_predictors(model, tiny_run.chart(model, film), film, config)
    assert json.loads(json.dumps(scores, allow_nan=False)) == scores
    assert list(scores) == [MEAN_IMAGE, "Hold", "Nearest neighbour", "Linear least squares"]
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
    assert scores["Linear least squares"]["dynamics"] == "linear"
