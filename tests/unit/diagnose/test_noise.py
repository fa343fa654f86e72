"""Local cubics, the noise they leave, and what a record is prepared from."""

import numpy as np
import pytest

from lagsplat.diagnose.core.config import DATASET
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.data_quality.noise import estimate_noise_level, fit_local_cubic
from lagsplat.diagnose.estimation.dataset import prepare_dataset
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, swing

CLIPS = np.array([[0, 60], [60, 100]])


def uneven() -> np.ndarray:
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.03, 100))
    time[60:] -= time[60]
    return time


def test_cubics_are_given_back_with_slope_and_curvature_however_uneven_the_times() -> None:
    t = uneven()
    q = np.stack([1.0 - 2.0 * t + 0.5 * t**2 - 3.0 * t**3, t], axis=1)
    smooth, slope, bend = fit_local_cubic(t, q, CLIPS, width_s=0.3)
    assert np.abs(smooth - q).max() < 1e-9
    assert np.abs(slope[:, 0] - (-2.0 + t - 9.0 * t**2)).max() < 1e-7
    assert np.abs(bend[:, 0] - (1.0 - 18.0 * t)).max() < 1e-5


def test_a_cut_is_not_smoothed_over() -> None:
    t = uneven()
    q = np.where(np.arange(100) < 60, 0.0, 5.0)[:, None]
    smooth, slope, _ = fit_local_cubic(t, q, CLIPS, width_s=0.3)
    assert np.abs(smooth - q).max() < 1e-9
    assert np.abs(slope).max() < 1e-7


def test_the_level_of_noise_is_found_and_outliers_do_not_raise_it() -> None:
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(1500)
    clean = np.stack([np.sin(3.0 * t), np.cos(2.0 * t)], axis=1)
    q = clean + rng.normal(size=clean.shape) * [0.01, 0.05]
    q[::400] += 0.5
    found = estimate_noise_level(t, q, np.array([[0, 700], [700, 1500]]), width_s=0.3)
    assert found == pytest.approx([0.01, 0.05], rel=0.1)


def test_a_noise_free_motion_is_given_the_least_noise() -> None:
    ready = prepare_dataset([swing(noise=0.0, seconds=6.0)], period_s=PERIOD_S)
    rms = ready.dataset.q.std(axis=0)
    assert (ready.sigma >= DATASET.min_relative_noise * rms).all()
    assert (ready.sigma < 2e-3 * rms).all()


def test_velocities_of_a_noisy_swing_are_near_the_true_ones() -> None:
    true = swing(noise=0.0, seconds=8.0, rate_hz=240.0)
    ready = prepare_dataset([swing(noise=0.01, seconds=8.0)], period_s=PERIOD_S)
    v = np.gradient(true.q[:, 0], true.time_s)[::4]
    off = ready.dataset.v[5:-5, 0] - v[5:-5]
    assert off.std() < 0.05 * v.std()


def test_the_rough_period_is_that_of_the_swing() -> None:
    assert estimate_spectral_period_s([swing(seconds=12.0), swing(seconds=8.0, seed=1)]) == pytest.approx(
        PERIOD_S, rel=0.05
    )


def test_nothing_that_moves_is_refused() -> None:
    n = 100
    still = Trajectory(time_s=0.01 * np.arange(n), q=np.zeros((n, 1)), u=np.zeros((n, 0)))
    with pytest.raises(ValueError, match="nothing moves"):
        estimate_spectral_period_s([still])
