"""The half-second forecast against a loop written by hand, and its treatment of divergence."""

import numpy as np
import pytest

from lagsplat.evaluate.forecast import image_forecast
from lagsplat.evaluate.protocol import EvaluationSeries
from tests.unit.evaluate.stand_ins import DT_S, integrate, render, settings, subject, world


def by_hand(held: EvaluationSeries, pictures, scale: float) -> list[float]:
    """Window by window and frame by frame, as the protocol is worded."""
    errors = []
    for start in np.random.default_rng(0).integers(held.skip, held.n_frames - 30, size=12):
        q = held.encoded[start]
        v = (-3 * q + 4 * held.encoded[start + 1] - held.encoded[start + 2]) / (2 * DT_S)
        q_all = integrate(q[None], v[None], held.forcing[None, start : start + 30], scale=scale)[0]
        total = 0.0
        for i in range(30):
            image = np.clip(render(q_all[i : i + 1])[0].astype(np.float64), 0, 1)
            total += np.mean((image - pictures(np.array([start + i]))[0]) ** 2)
        errors.append(total / 30)
    return errors


@pytest.mark.parametrize("scale", [1.0, 1.2])
def test_agrees_with_the_protocol_by_hand(scale):
    held, pictures = world(noise=0.01)
    model = subject(held=held, pictures=pictures, integrate=lambda *a: integrate(*a, scale=scale))
    result = image_forecast(model, settings())
    expected = by_hand(held, pictures, scale)
    assert result["states"] == 30
    assert np.allclose(result["per_window"], expected, rtol=1e-6)
    assert result["mse"] == pytest.approx(np.mean(expected))
    assert 3 <= result["distinct"] <= 12
    assert result["low"] < result["mse"] < result["high"]
    assert result["diverged"] == 0
    assert result["mse_staying"] == pytest.approx(result["mse"])


def test_true_law_beats_holding_the_first_frame_a_hundredfold():
    result = image_forecast(subject(), settings())
    assert result["mse"] < 0.01 * result["hold"]


@pytest.mark.parametrize("loss", [np.nan, 1e12])
def test_divergence_is_counted_and_never_pays(loss):
    def some_diverge(q0, v0, inputs, steps_s):
        rollouts = integrate(q0, v0, inputs, steps_s)
        rollouts[:5, 10:] = loss
        return rollouts

    sound = image_forecast(subject(), settings())
    result = image_forecast(subject(integrate=some_diverge), settings())
    assert result["diverged"] == 5
    assert result["windows"] == len(result["per_window"]) == 12
    assert np.isfinite(result["per_window"]).all()
    assert np.all(np.array(result["per_window"][:5]) > np.array(sound["per_window"][:5]))
    assert result["per_window"][5:] == sound["per_window"][5:]
    assert result["mse_staying"] == pytest.approx(np.mean(sound["per_window"][5:]))


def test_a_law_that_always_diverges_scores_worse_than_the_mean_frame_after_its_first_state():
    def lost(q0, v0, inputs, steps_s):
        rollouts = np.full((len(q0), inputs.shape[1], 2), np.nan)
        rollouts[:, 0] = q0
        return rollouts

    result = image_forecast(subject(integrate=lost), settings())
    assert result["diverged"] == 12
    assert result["mse_staying"] is None
    assert result["mse"] > 0.9 * result["mean_frame"]


def test_one_window_has_no_interval():
    result = image_forecast(subject(), settings(starts=1))
    assert result["distinct"] == 1
    assert result["low"] is None
    assert result["high"] is None
