"""What a law leaves of a chart whose error repeats itself is taken for noise, coordinate by coordinate."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.fit import DynamicsFit
from lagsplat.stage2.likelihood.likelihood_fit import LikelihoodFit
from lagsplat.stage2.likelihood.weak_form_fit import WeakFormFit
from tests.stage2_problems import form
from tests.unit.stage2.test_fit import config

DT_S, N = 1 / 60, 1500
POLYNOMIAL = form(terms="polynomial", potential_degree=2, input_degree=1, matrix_degree=0, map_degree=1)
WIGGLE = 0.05  # of the second coordinate, a function of the state


@pytest.fixture(scope="module")
def motion() -> EncodedTrajectory:
    """Two modes, each driven by an input of its own below 1.5 Hz."""
    rng = np.random.default_rng(0)
    time_s = DT_S * np.arange(N)
    inputs = np.zeros((N, 2))
    for frequency_hz in rng.uniform(0.1, 1.5, 6):
        phase = rng.uniform(0, 2 * np.pi, 2)
        inputs += rng.uniform(0.3, 1.0, 2) * np.sin(2 * np.pi * frequency_hz * time_s[:, None] + phase)
    drive = CubicSpline(time_s, inputs)
    stiffness, damping = (2 * np.pi * np.array([2.0, 5.0])) ** 2, 2 * np.array([0.8, 3.0])

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = state[:2], state[2:]
        return np.concatenate([v, stiffness * (drive(t) - q) - damping * v])

    solved = solve_ivp(rate, (0, time_s[-1]), np.zeros(4), t_eval=time_s, rtol=1e-8, atol=1e-8, max_step=0.01)
    x = solved.y[:2].T
    x = (x - x.mean(0)) / x.std(0)
    latents = x + 5e-4 * rng.standard_normal(x.shape)
    latents[:, 1] += WIGGLE * np.sqrt(2) * np.sin(3 * x[:, 0] + 2 * x[:, 1])
    return EncodedTrajectory(latents, inputs, time_s, ((0, N),))


def test_noise_is_what_a_good_law_leaves(motion: EncodedTrajectory) -> None:
    settings = config(form=POLYNOMIAL)
    smooth = motion.smoothed(1.0)
    fit = DynamicsFit(smooth, np.eye(2), settings, 0, lambda row: None)
    weak_form = WeakFormFit(
        motion,
        smooth,
        settings.form,
        time_unit_s=fit.time_unit_s,
        period_frames=fit.period_frames,
        seed=0,
        measure=fit.score_law,
        validate=fit.validation.measure,
    )
    likelihood = LikelihoodFit(weak_form, smooth, settings.likelihood)
    start = weak_form.choose_start()
    balanced = likelihood._estimate_residual_noise(start)
    assert start.noise.max() < 0.5 * WIGGLE  # what smoothing removes
    assert balanced.noise[1] == pytest.approx(WIGGLE, rel=0.3)
    assert balanced.noise[0] < 0.3 * WIGGLE
    assert not balanced.errors.is_worse_than(start.errors)
