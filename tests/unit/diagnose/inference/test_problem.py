"""How many samples of a residual count as one."""

import numpy as np

from lagsplat.diagnose.estimation.multiple_shooting import compute_autocorrelation_time

RNG = np.random.default_rng(5)


def series(rho, *, windows=40, length=400):
    made = np.zeros((windows, length, 2))
    noise = RNG.standard_normal(made.shape)
    made[:, 0] = noise[:, 0] / np.sqrt(1.0 - rho**2)
    for k in range(1, length):
        made[:, k] = rho * made[:, k - 1] + noise[:, k]
    return made


def test_independent_samples_count_each():
    white = series(0.0)
    np.testing.assert_allclose(compute_autocorrelation_time(white, np.full(40, 400)), 1.0, atol=0.1)


def test_correlated_samples_count_as_their_autocorrelation_says():
    """(1 + rho) / (1 - rho) of an autoregression of first order."""
    tied = series(0.8)
    np.testing.assert_allclose(compute_autocorrelation_time(tied, np.full(40, 400)), 9.0, rtol=0.15)


def test_what_lies_beyond_a_window_does_not_count():
    padded = np.concatenate([series(0.8), np.full((40, 50, 2), 1e3)], axis=1)
    np.testing.assert_allclose(compute_autocorrelation_time(padded, np.full(40, 400)), 9.0, rtol=0.15)
