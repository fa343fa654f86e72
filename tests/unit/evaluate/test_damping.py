"""Decay rates, the modes of a law, and the comparison with truth."""

import numpy as np
import pytest

from lagsplat.evaluate.damping import compare_decay, compare_with_truth
from lagsplat.evaluate.free import free_windows
from tests.unit.evaluate.stand_ins import FREQUENCIES_HZ, RATES_PER_S, integrate, settings, world


def test_decay_of_the_true_law_is_read_on_both_sides():
    held, _ = world(noise=0.002)
    result = compare_decay(*free_windows(held, integrate, settings()))
    assert result["encoded_per_s"] == pytest.approx(0.4, rel=0.03)
    assert result["rollout_per_s"] == pytest.approx(0.4, rel=0.03)
    assert result["value"] < 0.03
    assert result["missing"] == 0


def test_a_law_that_stands_still_is_missing_and_not_perfect():
    held, _ = world()

    def still(q0, v0, inputs, steps_s):
        return np.tile(q0[:, None], (1, inputs.shape[1], 1))

    result = compare_decay(*free_windows(held, still, settings()))
    assert result["value"] is None
    assert result["missing"] == len(result["windows"]) > 0
    assert result["reason"]


def test_truth_is_compared_with_the_measured_mode():
    mode = {"frequency_hz": 1.428, "rate_per_s": 0.5, "frequency_sigma": 0.0, "rate_sigma": 0.0, "share": 1.0}
    metrics = {
        "damping": {"windows": [{"encoded": {**mode, "frequency_hz": 1.4}, "rollout": mode}]},
        "linear_modes": [
            {"frequency_hz": 0.0, "rate_per_s": 9.0},
            {"frequency_hz": 1.33, "rate_per_s": 0.4},
            {"frequency_hz": 2.3, "rate_per_s": 1.0},
        ],
    }
    result = compare_with_truth(metrics, damped_frequencies_hz=FREQUENCIES_HZ, decay_rates_per_s=RATES_PER_S)
    assert result["mode"] == 1
    assert result["rollout"]["frequency_error"] == pytest.approx(0.02)
    assert result["rollout"]["decay_error"] == pytest.approx(0.25)
    assert result["encoded"]["frequency_error"] == pytest.approx(0.0)
    assert result["linearised"]["frequency_error"] == pytest.approx(0.05)


def test_truth_without_measurement_is_null():
    metrics = {"damping": {"windows": []}, "linear_modes": []}
    result = compare_with_truth(metrics, damped_frequencies_hz=FREQUENCIES_HZ, decay_rates_per_s=RATES_PER_S)
    assert result["mode"] == 1
    assert result["rollout"] is result["encoded"] is result["linearised"] is None
