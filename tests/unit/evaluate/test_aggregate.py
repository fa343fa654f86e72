"""Seeds in one row, and two experiments window by window."""

import copy

import numpy as np
import pytest
from scipy.stats import t

from lagsplat.evaluate.aggregate import (
    SPREAD_OVER_SEEDS,
    SPREAD_OVER_WINDOWS,
    aggregate,
    jackknife_interval,
    paired_margin,
)


def run(mse: float, *, frequency_error: float | None = 0.05, diverged: int = 0, seed: int = 0) -> dict:
    """Metrics of one run, as far as rows are made of them."""
    per_window = mse * np.random.default_rng(seed).uniform(0.8, 1.2, size=50)
    return {
        "schema": 1,
        "recording": {"origin": "simulated", "source": "arm", "sha256": "0"},
        "d": 4,
        "dynamics": "nonlinear",
        "scores": {
            "ae_floor": 4e-5,
            "mse_half_second": mse,
            "mse_ahead": 1.1 * mse,
            "frequency_error": frequency_error,
            "latent_nrmse": 0.2,
            "image_ratio": 12.0,
            "external_force": "anywhere",
            "diverged": diverged,
            "rollouts": 101,
        },
        "intervals": {"mse_half_second": [0.9 * mse, 1.1 * mse], "frequency_error": [None, None]},
        "forecast": {
            **{"per_window": per_window.tolist(), "starts": list(range(0, 1500, 30)), "states": 30},
            "distinct": 50,
        },
        "latent": {"distinct": 12},
        "frequency": {"n_windows": 1, "estimator": "spectral peak"},
    }


def test_median_and_range_over_seeds():
    row = aggregate([run(value) for value in (3.0, 1.0, 2.0, 5.0, 4.0)])
    assert row["scores"]["mse_half_second"] == {"median": 3.0, "low": 1.0, "high": 5.0, "n": 5}
    assert row["spread"] == SPREAD_OVER_SEEDS
    assert row["n_seeds"] == 5


def test_a_shared_floor_has_no_spread():
    assert aggregate([run(1.0), run(2.0)])["scores"]["ae_floor"] == {
        "median": 4e-5,
        "low": None,
        "high": None,
        "n": 2,
    }


def test_one_seed_shows_its_interval_over_windows():
    row = aggregate([run(2.0)])
    assert row["spread"] == SPREAD_OVER_WINDOWS
    assert row["scores"]["mse_half_second"]["low"] == pytest.approx(1.8)
    assert row["scores"]["frequency_error"]["low"] is None


def test_missing_scores_are_counted_and_divergence_is_summed():
    row = aggregate([run(1.0, diverged=3), run(2.0, frequency_error=None, diverged=4)])
    assert row["scores"]["frequency_error"]["n"] == 1
    assert row["diverged"] == 7
    assert row["rollouts"] == 202
    assert (row["windows"], row["long_windows"]) == (50, 12)
    assert aggregate([run(1.0, frequency_error=None)])["scores"]["frequency_error"]["median"] is None


def test_what_cannot_share_a_row_is_refused():
    other = copy.deepcopy(run(1.0))
    other["recording"]["origin"] = "filmed"
    with pytest.raises(ValueError, match="different recording"):
        aggregate([run(1.0), other])
    with pytest.raises(ValueError, match="at least one run"):
        aggregate([])


def test_seeds_that_end_with_a_linear_law_share_a_row():
    other = run(1.0) | {"dynamics": "linear"}
    assert aggregate([run(1.0), other])["dynamics"] == "linear or nonlinear"


def test_paired_margin_sees_what_overlapping_means_hide():
    """Two per cent better on every window: far below the spread over windows, yet certain."""
    ours, theirs = run(1.0), run(1.0)
    theirs["forecast"]["per_window"] = [1.02 * value for value in ours["forecast"]["per_window"]]
    margin = paired_margin([ours], [theirs], score="mse_half_second")
    assert margin["decided"]
    assert margin["relative"] == pytest.approx(0.02 / 1.02)
    assert margin["low"] > 0
    assert not paired_margin([ours], [ours], score="mse_half_second")["decided"]
    assert paired_margin([theirs], [ours], score="mse_half_second")["high"] < 0


def test_pairs_need_the_same_windows():
    other = run(1.0)
    other["forecast"]["starts"] = list(range(1, 1501, 30))
    with pytest.raises(ValueError, match="windows differ"):
        paired_margin([run(1.0)], [other], score="mse_half_second")


def test_the_interval_of_a_mean_of_single_windows_is_students():
    values = np.random.default_rng(0).normal(3.0, 1.0, size=40)
    low, high = jackknife_interval(lambda mean: mean, values, groups=np.arange(40), confidence=0.95)
    wanted = t.interval(0.95, 39, values.mean(), values.std(ddof=1) / np.sqrt(40))
    assert [low, high] == pytest.approx(list(wanted))


def test_the_interval_of_an_error_is_as_wide_either_way_in_its_logarithm():
    """One bad window in five would send a symmetric interval below zero."""
    values = np.array([0.1, 0.1, 0.1, 0.1, 2.0])
    low, high = jackknife_interval(float, values, groups=np.arange(5), positive=True)
    assert 0.0 < low < values.mean() < high
    assert low * high == pytest.approx(values.mean() ** 2)
    assert jackknife_interval(float, values, groups=np.arange(5))[0] < 0.0
    narrow = np.random.default_rng(0).normal(3.0, 0.01, size=40)
    plain, of_logarithm = (
        jackknife_interval(float, narrow, groups=np.arange(40), positive=each) for each in (False, True)
    )
    assert of_logarithm == pytest.approx(plain, rel=1e-4)
    assert jackknife_interval(float, np.zeros(5), groups=np.arange(5), positive=True) == [0.0, 0.0]


def test_overlapping_windows_do_not_narrow_an_interval():
    few = np.random.default_rng(0).normal(3.0, 1.0, size=4)
    repeated, groups = np.repeat(few, 12), np.repeat(np.arange(4), 12)
    alone = jackknife_interval(lambda mean: mean, few, groups=np.arange(4))
    assert jackknife_interval(lambda mean: mean, repeated, groups=groups) == pytest.approx(alone)
    assert jackknife_interval(lambda mean: mean, few[:2], groups=np.arange(2)) == [None, None]
