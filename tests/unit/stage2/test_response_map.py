"""A map, and with it a linear law, where the inputs tell which functions of the latents answer linearly."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.equilibrium import linearize_modes
from lagsplat.stage2.fit import fit_dynamics
from lagsplat.stage2.likelihood.guard import LEAST_STRETCH
from lagsplat.stage2.likelihood.response_map import fit_response_map
from tests.stage2_problems import form
from tests.unit.stage2.test_fit import config

DT_S, N = 1 / 60, 3000
FREQUENCY_HZ, DECAY_PER_S = np.array([2.0, 5.0]), np.array([0.8, 3.0])


def mechanism() -> tuple[np.ndarray, np.ndarray]:
    """Two linear modes of unit size, each driven by an input of its own below 1.5 Hz, and the inputs."""
    rng, time_s = np.random.default_rng(0), DT_S * np.arange(N)
    inputs = np.zeros((N, 2))
    for frequency_hz in rng.uniform(0.1, 1.5, 8):
        phase = rng.uniform(0, 2 * np.pi, 2)
        inputs += rng.uniform(0.3, 1.0, 2) * np.sin(2 * np.pi * frequency_hz * time_s[:, None] + phase)
    drive, stiffness = CubicSpline(time_s, inputs), (2 * np.pi * FREQUENCY_HZ) ** 2

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = state[:2], state[2:]
        return np.concatenate([v, stiffness * (drive(t) - q) - 2 * DECAY_PER_S * v])

    solved = solve_ivp(rate, (0, time_s[-1]), np.zeros(4), t_eval=time_s, rtol=1e-8, atol=1e-8, max_step=0.01)
    x = solved.y[:2].T
    return (x - x.mean(axis=0)) / x.std(axis=0), inputs


def record(bend: float, *, noise: float = 5e-4) -> tuple[np.ndarray, EncodedTrajectory]:
    """The modes, and latents that are bent by them: each by the square of the other."""
    x, inputs = mechanism()
    latents = x + bend * (x[:, ::-1] ** 2 - 1.0) + noise * np.random.default_rng(1).standard_normal(x.shape)
    return x, EncodedTrajectory(latents, inputs, DT_S * np.arange(N), ((0, N),))


def unexplained(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Rms of the part of each column of ``y`` that no linear function of ``x`` explains."""
    columns = np.c_[np.ones(len(x)), x]
    return (y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]).std(axis=0)


def test_bent_latents_become_straight() -> None:
    x, motion = record(0.08)
    coordinates = fit_response_map(motion, degree=4)
    assert coordinates is not None
    straight = coordinates.evaluate(torch.from_numpy(motion.latents))[0].detach().numpy()
    assert (unexplained(motion.latents, x) > 0.08).all()
    assert (unexplained(straight, x) < 0.02).all()
    zero = torch.zeros(1, 2, dtype=torch.float64)
    torch.testing.assert_close(coordinates.evaluate(zero)[1][0], torch.eye(2, dtype=torch.float64))


def test_a_map_that_folds_is_drawn_back() -> None:
    _, motion = record(0.3)
    coordinates = fit_response_map(motion, degree=2)
    assert coordinates is not None
    assert coordinates.measure_least_stretch() >= LEAST_STRETCH


@pytest.mark.parametrize("inputs", ["none", "still", "others"])
def test_latents_that_no_input_explains_have_no_map(inputs: str) -> None:
    _, motion = record(0.08)
    u = {"none": np.zeros((N, 0)), "still": np.ones((N, 1))}.get(inputs)
    strange = np.random.default_rng(2).standard_normal((N, 1))
    assert fit_response_map(replace(motion, inputs=strange if u is None else u), degree=2) is None


def test_a_linear_law_is_kept_where_it_forecasts_as_well() -> None:
    _, motion = record(0.08)
    linear = form(terms="polynomial", potential_degree=None, map_degree=None, matrix_degree=0)
    settings = config(form=linear)
    law, report = fit_dynamics(
        motion.smoothed(1.0), np.eye(2), settings, 0, rest=np.zeros(2), measured=motion
    )
    assert (law.form.degrees.potential, law.form.degrees.matrices) == (2, 0)
    assert law.form.degrees.coordinates > 1
    modes = linearize_modes(law, torch.zeros(2, dtype=torch.float64))
    order = np.argsort(modes.frequency_hz)
    natural = np.sqrt(FREQUENCY_HZ**2 - (DECAY_PER_S / (2 * np.pi)) ** 2)
    assert np.array(modes.frequency_hz)[order] == pytest.approx(natural, rel=0.02)
    assert np.array(modes.decay_per_s)[order] == pytest.approx(DECAY_PER_S, rel=0.1)
    assert report.draws is not None
