"""The spectral estimator on tones."""

import numpy as np
import pytest

from lagsplat.evaluate.spectrum import find_peak_frequency, find_spectral_peak
from tests.unit.evaluate.stand_ins import DT_S, METRIC

TIME_S = DT_S * np.arange(307)


def tones(visible_hz: float, hidden_hz: float, rate: float = 0.0) -> np.ndarray:
    decay = np.exp(-rate * TIME_S)
    hidden = 3.0 * decay * np.cos(2 * np.pi * hidden_hz * TIME_S + 0.4)
    return np.stack([hidden, decay * np.cos(2 * np.pi * visible_hz * TIME_S + 1.0)], axis=1)


@pytest.mark.parametrize("frequency_hz", [1.31, 1.437, 1.5621, 2.0, 4.6])
def test_tone_is_found_within_two_hundredths_of_a_bin(frequency_hz):
    peak = find_spectral_peak(tones(frequency_hz, frequency_hz), dt_s=DT_S, metric=METRIC, min_cycles=1.5)
    bin_hz = 1 / (307 * DT_S)
    assert peak.visible_hz == pytest.approx(frequency_hz, abs=0.02 * bin_hz)
    assert peak.weighted_hz == pytest.approx(frequency_hz, abs=0.02 * bin_hz)
    assert peak.uncertainty_hz < 0.05 * bin_hz


def test_only_the_visible_mode_speaks_and_offsets_do_not():
    peak = find_spectral_peak(tones(1.4, 3.7) + 50.0, dt_s=DT_S, metric=METRIC, min_cycles=1.5)
    assert peak.visible_hz == pytest.approx(1.4, rel=0.01)
    strong = find_spectral_peak(tones(1.4, 3.7), dt_s=DT_S, metric=np.diag([0.9, 1.1]), min_cycles=1.5)
    assert strong.weighted_hz == pytest.approx(3.7, rel=0.01)
    assert strong.visible_hz == pytest.approx(1.4, rel=0.01)


def test_a_moderate_decay_biases_by_less_than_half_a_percent():
    peak = find_spectral_peak(tones(1.44, 1.44, rate=0.17), dt_s=DT_S, metric=METRIC, min_cycles=1.5)
    assert peak.visible_hz == pytest.approx(1.44, rel=0.005)


@pytest.mark.parametrize("series", [np.zeros((307, 2)), np.exp(-2.0 * TIME_S)[:, None] * np.ones(2)])
def test_no_oscillation_is_no_frequency(series):
    assert find_spectral_peak(series, dt_s=DT_S, metric=METRIC, min_cycles=1.5).visible_hz is None


def test_parabola_is_refused_where_it_is_not_a_peak():
    assert find_peak_frequency(np.array([9.0, 3.0, 2.0, 1.0, 0.5]), 1.0, 1.5) is None
    assert find_peak_frequency(np.array([0.0, 0.0, 1.0, 1.0, 0.5]), 1.0, 1.5) == 2.0
    assert find_peak_frequency(np.array([0.1, 0.5, 1.0, 0.5, 0.1]), 2.0, 1.5) == pytest.approx(1.0)
