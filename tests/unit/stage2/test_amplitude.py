"""A motion of nearly one amplitude does not tell springs from a bent chart: the simpler law is taken."""

import numpy as np
import torch
from scipy.signal import lfilter

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.fit import fit_dynamics
from lagsplat.stage2.lagrangian import linearize_modes
from tests.stage2_problems import form
from tests.unit.stage2.test_fit import config

FREQUENCY_HZ, DECAY_PER_S, DT_S, N = 0.63, 0.006, 1 / 30, 180
FREE = form(terms="polynomial", potential_degree=None, map_degree=None, matrix_degree=2)


def record(seed: int) -> EncodedTrajectory:
    """Four swings of a linear oscillator in a randomly bent coordinate, with coloured noise of 1 %."""
    rng = np.random.default_rng(seed)
    time_s = DT_S * np.arange(N)
    phase = 2 * np.pi * FREQUENCY_HZ * time_s + rng.uniform(0, 6.28)
    x = 1.41 * np.exp(-DECAY_PER_S * time_s) * np.sin(phase)
    z = x + rng.uniform(-0.15, 0.15) * x**2 + rng.uniform(-0.06, 0.06) * x**3
    noise = lfilter([1.0], [1.0, -0.7], np.sqrt(1.0 - 0.49) * rng.standard_normal(N))
    z = (z - z.mean()) / z.std() + 0.01 * noise
    return EncodedTrajectory(z[:, None], np.zeros((N, 0)), time_s, ((0, N),))


def test_a_linear_oscillator_in_a_bent_chart_keeps_its_frequency_at_rest() -> None:
    errors = []
    for seed in range(2, 7):
        motion = record(seed)
        law, _ = fit_dynamics(motion, np.eye(1), config(form=FREE), 0, rest=np.zeros(1), measured=motion)
        found = linearize_modes(law, torch.zeros(0, dtype=torch.float64)).frequency_hz[0]
        errors.append(abs(found / FREQUENCY_HZ - 1.0))
    assert np.median(errors) < 2e-3
