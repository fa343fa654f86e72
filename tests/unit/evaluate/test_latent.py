"""Latent error over two periods."""

import numpy as np
import pytest

from lagsplat.evaluate.forecast import latent_forecast
from lagsplat.evaluate.protocol import squared_norm
from tests.unit.evaluate.stand_ins import DT_S, METRIC, integrate, settings, subject, world

PERIOD_S = 1 / 1.4


def score(law):
    held, pictures = world(noise=0.02)
    model = subject(held=held, pictures=pictures, integrate=law(held))
    return latent_forecast(model, settings(starts=60), period_s=PERIOD_S)


def test_perfect_prediction_has_no_error():
    """The encoded states themselves, found by their start: NRMSE 0 and the image error at the floor."""

    def oracle(held):
        def law(q0, v0, inputs, steps_s):
            starts = [int(np.argmin(np.abs(held.encoded - q).sum(axis=1))) for q in q0]
            return np.stack([held.encoded[s : s + inputs.shape[1]] for s in starts])

        return law

    result = score(oracle)
    assert result["states"] == round(2 * PERIOD_S / DT_S)
    assert result["nrmse"] == pytest.approx(0.0, abs=1e-12)
    assert result["image_ratio"] == pytest.approx(1.0)
    assert result["image_ratio_interval"] == pytest.approx([1.0, 1.0])


def test_predicting_the_mean_scores_about_one():
    def mean(held):
        return lambda q0, v0, inputs, steps_s: np.tile(
            held.encoded.mean(axis=0), (len(q0), inputs.shape[1], 1)
        )

    result = score(mean)
    assert result["nrmse"] == pytest.approx(1.0, abs=0.15)
    low, high = result["nrmse_interval"]
    assert low < result["nrmse"] < high


def test_true_law_is_far_better_than_holding():
    result = score(lambda held: integrate)
    assert result["nrmse"] < 0.4
    assert result["nrmse_hold"] > 0.8


def test_divergence_never_beats_the_mean_prediction():
    def lost(held):
        return lambda q0, v0, inputs, steps_s: np.full((len(q0), inputs.shape[1], 2), np.nan)

    result = score(lost)
    assert result["diverged"] == result["windows"] == 60
    assert result["nrmse_staying"] is None
    assert result["nrmse"] > 1.0


def test_norm_is_taken_in_the_metric():
    assert squared_norm(np.array([[1.0, 0.0], [0.0, 2.0]]), METRIC) == pytest.approx([0.1, 7.6])


def test_a_horizon_longer_than_the_clip_is_a_reason_and_no_failure():
    found = latent_forecast(subject(), settings(), period_s=1000.0)
    assert list(found) == ["reason"]
    assert "shorten the horizon" in found["reason"]
