"""The comparison of free frequencies."""

import numpy as np
import pytest

from lagsplat.evaluate.free_motion import FITTED, SPECTRAL, compare_frequency, cut_free_windows
from tests.unit.evaluate.stand_ins import DT_S, integrate, settings, world


def compare(held, law, **changes):
    windows, reason = cut_free_windows(held, law, settings(**changes))
    return compare_frequency(windows, reason, dt_s=DT_S)


@pytest.mark.parametrize("scale", [1.0, 0.96, 1.1])
def test_a_detuned_law_is_off_by_as_much(scale):
    held, _ = world(noise=0.002)
    result = compare(held, lambda *a: integrate(*a, scale=scale))
    assert result["estimator"] == SPECTRAL
    assert result["value"] == pytest.approx(abs(scale - 1), abs=0.006)
    assert result["signed"] == pytest.approx(scale - 1, abs=0.006)
    assert result["others"][FITTED]["value"] == pytest.approx(abs(scale - 1), abs=0.006)
    assert result["low"] <= result["value"] <= result["high"]


def test_one_window_is_called_a_point():
    held, _ = world(tail=350)
    result = compare(held, integrate)
    assert result["n_windows"] == len(result["windows"]) == 1
    assert result["note"] == "single window: a point"


def test_several_windows_are_all_listed():
    held, _ = world(tail=800)
    result = compare(held, integrate, window_min_amplitude=0.01)
    assert result["n_windows"] == len(result["windows"]) == 2
    assert result["note"] == ""
    assert all(row["rollout"][SPECTRAL][0] is not None for row in result["windows"])


@pytest.mark.parametrize("fate", ["still", "lost"])
def test_a_rollout_without_an_oscillation_errs_by_one(fate):
    def law(q0, v0, inputs, steps_s):
        rollouts = np.tile(q0[:, None], (1, inputs.shape[1], 1))
        rollouts[:, 100:] = np.nan if fate == "lost" else rollouts[:, :1]
        return rollouts

    result = compare(world()[0], law)
    assert result["value"] == 1.0
    assert result["rollout_hz"] is None
    assert all(row["diverged"] == (fate == "lost") for row in result["windows"])


def test_nothing_to_measure_is_null_with_a_reason():
    result = compare_frequency([], "because", dt_s=DT_S)
    assert result["value"] is None
    assert result["reason"] == "because"
