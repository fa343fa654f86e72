"""Noise: its size whatever the motion, its correlation where there is one, its quantisation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from lagsplat.diagnose.data_quality.noise import find_quantisation_step, measure_noise
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, multisine, swing


@pytest.mark.parametrize("rate_hz", [20.0, 60.0, 1000.0])
@pytest.mark.parametrize("noise", [0.001, 0.01, 0.1])
def test_the_size_of_white_noise(noise: float, rate_hz: float) -> None:
    clean = swing(noise=0.0, rate_hz=rate_hz).q.std(axis=0)
    found = measure_noise([swing(noise=noise, rate_hz=rate_hz)], period_s=PERIOD_S)
    assert found.sigma / clean == pytest.approx(noise, rel=0.2)
    assert found.correlation == pytest.approx(0.0)


def test_motion_is_no_noise() -> None:
    for drive in (None, np.sin(2.0 * np.pi * np.arange(900) / 60.0 / 0.44), multisine(900)):
        clean = swing(noise=0.0, drive=drive)
        assert (measure_noise([clean], period_s=PERIOD_S).sigma < 3e-4 * clean.q.std(axis=0)).all()


def test_kinks_are_no_noise() -> None:
    """A triangle has corners, and a rest has nothing at all."""
    time = np.arange(1200) / 60.0
    triangle = np.abs((time % np.sqrt(1.1)) - 0.5)
    triangle[600:] = triangle[600]
    noisy = triangle + 1e-3 * np.random.default_rng(0).normal(size=1200)
    found = measure_noise([Trajectory(time_s=time, q=noisy[:, None], u=np.zeros((1200, 0)))], period_s=1.0)
    assert found.sigma == pytest.approx(1e-3, rel=0.5)
    still = Trajectory(time_s=time, q=triangle[:, None], u=np.zeros((1200, 0)))
    assert measure_noise([still], period_s=1.0).sigma < 1e-4


@pytest.mark.parametrize("rho", [0.3, 0.6])
def test_correlated_noise_is_told_from_white(rho: float) -> None:
    motion = swing(noise=0.0, seconds=40.0)
    white = np.random.default_rng(1).normal(size=motion.n + 100)
    errors = 0.01 * lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white)[100:]
    found = measure_noise([replace(motion, q=motion.q + errors[:, None])], period_s=PERIOD_S)
    assert found.correlation[0] == pytest.approx(rho, abs=0.2)
    assert found.sigma[0] == pytest.approx(0.01, rel=0.35)


def test_each_coordinate_has_its_own_noise_and_units() -> None:
    motion = swing(start=(1.0, 0.5), noise=0.0)
    errors = np.random.default_rng(0).normal(size=motion.q.shape) * [1e-3, 2e-2]
    found = measure_noise([replace(motion, q=(motion.q + errors) * [1.0, 1e4])], period_s=PERIOD_S)
    np.testing.assert_allclose(found.sigma, [1e-3, 2e2], rtol=0.2)


def test_quantisation_is_found_and_counts_as_noise() -> None:
    motion = swing(noise=0.0)
    rounded = replace(motion, q=0.02 * np.rint(motion.q / 0.02))
    found = measure_noise([rounded], period_s=PERIOD_S)
    assert found.step == pytest.approx(0.02)
    assert 0.02 / np.sqrt(12.0) - 1e-12 <= found.sigma[0] < 0.02
    assert find_quantisation_step(swing().q[:, 0]) == 0.0
    assert find_quantisation_step(np.ones(50)) == 0.0


def test_clips_too_short_have_no_noise_to_show() -> None:
    assert np.isnan(measure_noise([swing(seconds=0.1)], period_s=None).sigma).all()
