"""Noise level, correlation and quantisation of known noise, and local cubics on exact cubics."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from lagsplat.diagnose.core.config import ESTIMATION
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.data_quality.noise import (
    find_quantisation_step,
    fit_over_time,
    measure_noise,
    measure_residual_noise,
)
from lagsplat.diagnose.estimation.dataset import prepare_dataset
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


@pytest.mark.parametrize("lasting", [3.0, 7.0])
@pytest.mark.parametrize("samples_per_period", [150.0, 500.0])
def test_noise_that_lasts_is_no_motion(lasting: float, samples_per_period: float) -> None:
    motion = swing(noise=0.0, rate_hz=samples_per_period / PERIOD_S, seconds=25.0)
    rho = np.exp(-1.0 / lasting)
    white = np.random.default_rng(2).normal(size=motion.n + 100)
    errors = 0.01 * lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white)[100:]
    found = measure_noise([replace(motion, q=motion.q + errors[:, None])], period_s=PERIOD_S)
    assert found.correlation[0] == pytest.approx(rho, abs=0.1)
    assert found.sigma[0] == pytest.approx(0.01, rel=0.25)


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


def test_a_clip_as_long_as_the_shortest_window_has_noise() -> None:
    assert measure_noise([swing(noise=0.01, rate_hz=60.0, seconds=0.3)], period_s=PERIOD_S).sigma > 0.0


def test_an_uneven_clock_costs_no_precision() -> None:
    motion = swing(noise=0.01, rate_hz=100.0, seconds=40.0)
    rng = np.random.default_rng(4)
    uneven = motion.time_s + rng.uniform(-0.3, 0.3, motion.n) / 100.0
    clean = np.interp(uneven, motion.time_s, swing(noise=0.0, rate_hz=100.0, seconds=40.0).q[:, 0])
    noisy = clean + 0.01 * rng.normal(size=motion.n)
    found = measure_noise([replace(motion, time_s=uneven, q=noisy[:, None], v=None)], period_s=PERIOD_S)
    assert found.sigma == pytest.approx(0.01, rel=0.1)


def test_clips_too_short_have_no_noise_to_show() -> None:
    assert np.isnan(measure_noise([swing(seconds=0.1)], period_s=None).sigma).all()


def uneven(q: Callable[[np.ndarray], np.ndarray]) -> Trajectory:
    """A motion (N, d) at uneven times, cut after sixty samples."""
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.03, 100))
    return Trajectory(time_s=time, q=q(time), u=np.zeros((100, 0)), segments=((0, 60), (60, 100)))


def test_cubics_are_given_back_with_slope_and_curvature_however_uneven_the_times() -> None:
    motion = uneven(lambda t: np.stack([1.0 - 2.0 * t + 0.5 * t**2 - 3.0 * t**3, t], axis=1))
    fit, t = fit_over_time(motion, width_s=0.3), motion.time_s
    assert np.abs(fit.q - motion.q).max() < 1e-9
    assert np.abs(fit.v[:, 0] - (-2.0 + t - 9.0 * t**2)).max() < 1e-7
    assert np.abs(fit.a[:, 0] - (1.0 - 18.0 * t)).max() < 1e-5


def test_a_cut_is_not_smoothed_over() -> None:
    motion = uneven(lambda t: np.where(np.arange(100) < 60, 0.0, 5.0)[:, None])
    fit = fit_over_time(motion, width_s=0.3)
    assert np.abs(fit.q - motion.q).max() < 1e-9
    assert np.abs(fit.v).max() < 1e-7


@pytest.mark.parametrize(("rate_hz", "deviation"), [(10.0, 1.25), (20.0, 1.15), (30.0, 1.15)])
def test_fast_motion_sampled_slowly_is_no_noise(rate_hz: float, deviation: float) -> None:
    """Nine samples are nearly a whole swing at 10 Hz, which a polynomial of degree five does not follow."""
    motion = swing(noise=0.001, rate_hz=rate_hz, seconds=40.0)
    clean = swing(noise=0.0, rate_hz=rate_hz, seconds=40.0).q.std(axis=0)
    sigma = prepare_dataset([motion], period_s=PERIOD_S).sigma
    assert (0.001 * clean * 0.85 < sigma).all()
    assert (sigma < 0.001 * clean * deviation).all()


def test_outliers_do_not_raise_the_noise() -> None:
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(1500)
    q = np.stack([np.sin(3.0 * t), np.cos(2.0 * t)], axis=1) + rng.normal(size=(1500, 2)) * [0.01, 0.05]
    q[::400] += 0.5
    motion = Trajectory(time_s=t, q=q, u=np.zeros((1500, 0)), segments=((0, 700), (700, 1500)))
    assert measure_noise([motion], period_s=2.0).sigma == pytest.approx([0.01, 0.05], rel=0.15)


def test_a_noise_free_motion_is_given_the_least_noise() -> None:
    ready = prepare_dataset([swing(noise=0.0, seconds=6.0)], period_s=PERIOD_S)
    rms = ready.dataset.q.std(axis=0)
    assert (ready.sigma >= ESTIMATION.min_relative_noise * rms).all()
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


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 99), width_s=st.floats(0.1, 20.0), n=st.integers(4, 60))
def test_cubics_are_reproduced_at_uneven_times(seed: int, width_s: float, n: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5, 1.5, n))
    cubic = np.polynomial.Polynomial(rng.normal(size=4), domain=[time[0], time[-1]], window=[-1, 1])
    fit = fit_over_time(Trajectory(time_s=time, q=cubic(time)[:, None], u=np.zeros((n, 0))), width_s=width_s)
    for order, found in enumerate((fit.q, fit.v, fit.a)):
        truth = (cubic.deriv(order) if order else cubic)(time)
        np.testing.assert_allclose(found[:, 0], truth, atol=1e-6 * np.abs(truth).max())


def test_rates_are_as_noisy_as_they_say() -> None:
    rng = np.random.default_rng(0)
    noise = Trajectory(time_s=np.arange(4000) / 60.0, q=rng.normal(size=(4000, 1)), u=np.zeros((4000, 0)))
    fit = fit_over_time(noise, width_s=10 / 60.0)
    inside = slice(10, -10)
    assert fit.v[inside].std() == pytest.approx(float(fit.rate_gain[inside].mean()), rel=0.1)


def test_nothing_crosses_a_cut_and_short_clips_are_fitted_as_a_whole() -> None:
    motion = swing(noise=0.0)
    jump = replace(motion, q=np.where(np.arange(motion.n)[:, None] < 400, motion.q, motion.q + 7.0)).cut(
        [400]
    )
    np.testing.assert_allclose(
        fit_over_time(jump, width_s=0.1).v[:400], fit_over_time(motion.pieces([(0, 400)]), width_s=0.1).v
    )
    shreds = motion.cut([1, 3, 6])
    fit = fit_over_time(shreds, width_s=0.1)
    assert np.isfinite(np.hstack([fit.q, fit.v, fit.a])).all()
    np.testing.assert_allclose(fit.v[1], (motion.q[2] - motion.q[1]) * 60.0)
    assert fit.v[0] == 0.0


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.7])
def test_lasting_noise_shows_in_what_a_simulator_leaves_of_the_motion(correlation: float) -> None:
    """Windows of two periods of forty samples, with a gap of three noises beside the noise."""
    rng, n, sigma = np.random.default_rng(0), 80, 0.01
    time_s, found = 0.025 * np.arange(n), []
    for _ in range(8):
        windows = []
        for _ in range(12):
            white = rng.standard_normal(n + 100)
            noise = lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], white)[100:]
            gap = 3.0 * np.sin(2.0 * np.pi * time_s + rng.uniform(0.0, 6.0))
            windows.append(sigma * (noise + gap)[:, None])
        found.append(measure_residual_noise([time_s] * 12, windows, period_s=1.0)[0] / sigma)
    assert 0.7 < np.mean(found) < 1.1
