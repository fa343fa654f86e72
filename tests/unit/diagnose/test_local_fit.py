"""The local cubic is exact for cubics, at any times, and knows the noise of its rates."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lagsplat.diagnose.data_quality.noise import fit_locally
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import swing


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 99), half=st.integers(2, 9), n=st.integers(4, 60))
def test_cubics_are_reproduced_at_uneven_times(seed: int, half: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5, 1.5, n))
    cubic = np.polynomial.Polynomial(rng.normal(size=4), domain=[time[0], time[-1]], window=[-1, 1])
    fit = fit_locally(Trajectory(time_s=time, q=cubic(time)[:, None], u=np.zeros((n, 0))), half_width=half)
    for order, found in enumerate((fit.q, fit.v, fit.a)):
        truth = (cubic.deriv(order) if order else cubic)(time)
        np.testing.assert_allclose(found[:, 0], truth, atol=1e-6 * np.abs(truth).max())


def test_rates_are_as_noisy_as_they_say() -> None:
    rng = np.random.default_rng(0)
    noise = Trajectory(time_s=np.arange(4000) / 60.0, q=rng.normal(size=(4000, 1)), u=np.zeros((4000, 0)))
    fit = fit_locally(noise, half_width=5)
    inside = slice(10, -10)
    assert fit.v[inside].std() == pytest.approx(float(fit.rate_gain[inside].mean()), rel=0.1)


def test_nothing_crosses_a_cut_and_short_clips_are_fitted_as_a_whole() -> None:
    motion = swing(noise=0.0)
    jump = replace(motion, q=np.where(np.arange(motion.n)[:, None] < 400, motion.q, motion.q + 7.0)).cut(
        [400]
    )
    np.testing.assert_allclose(
        fit_locally(jump, half_width=4).v[:400], fit_locally(motion.pieces([(0, 400)]), half_width=4).v
    )
    shreds = motion.cut([1, 3, 6])
    fit = fit_locally(shreds, half_width=4)
    assert np.isfinite(np.hstack([fit.q, fit.v, fit.a])).all()
    np.testing.assert_allclose(fit.v[1], (motion.q[2] - motion.q[1]) * 60.0)
    assert fit.v[0] == 0.0
    with pytest.raises(ValueError, match="half_width is 1"):
        fit_locally(motion, half_width=1)
