import numpy as np
import pytest

from lagsplat.systems.pressures import draw_pressures, draw_random_band, spline_coefficients

DT_S = 1001 / 60000


def test_band_is_band_limited_with_unit_variance_and_falling_amplitude():
    n = 60_000
    x = draw_random_band(n, 3, (0.04, 2.0), dt_s=DT_S, generator=np.random.default_rng(0))
    np.testing.assert_allclose(x.std(axis=0), 1, atol=0.12)
    frequency = np.fft.rfftfreq(n, DT_S)
    power = np.mean(np.abs(np.fft.rfft(x, axis=0)) ** 2, axis=1)
    inside = (frequency >= 0.04) & (frequency <= 2.0)
    assert power[~inside].sum() < 1e-9 * power.sum()
    lower, upper = (frequency > 0.1) & (frequency < 0.4), (frequency > 0.5) & (frequency < 2)
    slope = [np.mean(power[part] * frequency[part] ** 2) for part in (lower, upper)]
    assert slope[0] == pytest.approx(slope[1], rel=0.25)
    assert np.abs(np.corrcoef(x.T) - np.eye(3)).max() < 0.3


def test_pressures_rest_drive_hold_and_release(load):
    config = load("krauss_2seg", n_frames=20_000)
    p = draw_pressures(config, generator=np.random.default_rng(1))
    release = config.n_frames - config.tail_frames
    assert np.all(p[: config.rest_frames + 1] == 0)
    np.testing.assert_allclose(p[release], config.hold_atm, rtol=1e-12)
    assert np.all(p[release + 8 :] == 0)
    driven = p[config.rest_frames + config.hold_frames : release - config.hold_frames]
    assert driven.min() >= 0
    assert driven.max() <= config.drive_max_atm
    low, high = np.quantile(driven, [0.05, 0.95])
    assert 0.05 < low < 0.18
    assert 0.75 < high < 0.88
    assert np.abs(np.diff(p[:release], axis=0)).max() < 0.06


def test_spline_passes_through_the_frames():
    p = np.random.default_rng(0).uniform(0, 1, (50, 2))
    c = spline_coefficients(p, dt_s=DT_S)
    np.testing.assert_allclose(c[3], p[:-1], atol=1e-12)
    end = ((c[0] * DT_S + c[1]) * DT_S + c[2]) * DT_S + c[3]
    np.testing.assert_allclose(end, p[1:], atol=1e-12)
