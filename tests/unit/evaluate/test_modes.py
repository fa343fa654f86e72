"""Damped oscillations recovered from noisy free motion, with uncertainties that hold."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from lagsplat.evaluate.modes import fit_modes
from tests.unit.evaluate.stand_ins import DT_S

METRIC = np.diag([0.03, 0.1, 0.5, 3.37])


def decay(rng, modes, frames, noise=0.01, drift=0.0):
    """Smoothed, noisy, offset, in four coordinates; ``modes`` are (frequency Hz, rate 1/s, size)."""
    time_s = DT_S * np.arange(-10, frames + 10)[:, None]
    series = rng.normal(size=4) + drift * np.exp(-time_s) * rng.normal(size=4)
    for frequency_hz, rate, size in modes:
        shapes = size * rng.normal(size=(2, 4))
        phase = 2 * np.pi * frequency_hz * time_s
        series = series + np.exp(-rate * time_s) * (np.cos(phase) * shapes[0] + np.sin(phase) * shapes[1])
    series = series + noise * rng.normal(size=series.shape)
    return gaussian_filter1d(series, 1.0, axis=0)[10:-10]


@pytest.mark.parametrize(
    ("frequency_hz", "rate", "frames", "drift"),
    [(1.44, 0.17, 307, 0.0), (2.67, 3.0, 180, 0.3), (2.67, 3.0, 600, 0.0), (4.6, 5.0, 180, 0.0)],
)
def test_accurate_and_covered(frequency_hz, rate, frames, drift):
    rng = np.random.default_rng(7)
    fits = [
        fit_modes(
            decay(rng, [(frequency_hz, rate, 1.0)], frames, drift=drift), dt_s=DT_S, metric=METRIC, most=3
        )[0]
        for _ in range(8)
    ]
    errors = np.array([(fit.frequency_hz - frequency_hz, fit.rate_per_s - rate) for fit in fits])
    sigmas = np.array([(fit.frequency_sigma, fit.rate_sigma) for fit in fits])
    assert np.abs(errors[:, 0]).max() < 0.02 * frequency_hz
    assert np.abs(np.median(errors[:, 1])) < 0.03 * rate
    assert np.mean(np.abs(errors) < 3 * sigmas) > 0.85
    assert np.median(sigmas[:, 0]) < 5 * np.std(errors[:, 0])


def test_two_modes_are_told_apart_and_ordered_by_energy():
    rng = np.random.default_rng(5)
    modes = fit_modes(
        decay(rng, [(2.68, 2.0, 1.0), (4.02, 2.0, 0.2)], 180, noise=0.003), dt_s=DT_S, metric=METRIC, most=3
    )
    assert modes[0].frequency_hz == pytest.approx(2.68, rel=0.02)
    assert modes[1].frequency_hz == pytest.approx(4.02, rel=0.05)
    assert modes[0].share > modes[1].share


@pytest.mark.parametrize("frames", [5, 200])
def test_a_still_or_short_series_has_no_mode(frames):
    assert fit_modes(np.ones((frames, 4)), dt_s=DT_S, metric=METRIC, most=3) == ()


def test_a_relaxation_is_no_oscillation():
    time_s = DT_S * np.arange(300)[:, None]
    assert fit_modes(np.exp(-2.0 * time_s) * np.ones(4), dt_s=DT_S, metric=METRIC, most=2) == ()
