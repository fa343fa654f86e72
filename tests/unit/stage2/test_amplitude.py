"""A motion of nearly one amplitude does not tell springs from a bent chart: the simpler law is taken.

What it says of smaller motion is compared with the smallest that it knows."""

import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.amplitude import count_oscillations, measure_quietest_frequency
from lagsplat.stage2.equilibrium import linearize_modes, move_rest_to_equilibrium
from lagsplat.stage2.fit import fit_dynamics
from tests.stage2_problems import form, random_lagrangian
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
    for seed in range(2, 5):
        motion = record(seed)
        law, _ = fit_dynamics(motion, np.eye(1), config(form=FREE), 0, rest=np.zeros(1), measured=motion)
        found = linearize_modes(law, torch.zeros(0, dtype=torch.float64)).frequency_hz[0]
        errors.append(abs(found / FREQUENCY_HZ - 1.0))
    assert np.median(errors) < 2e-3


def test_a_hardening_spring_is_faster_at_its_smallest_recorded_amplitude_than_at_rest() -> None:
    law = random_lagrangian(1, 0, 0, amount=0.0, terms="polynomial", potential_degree=4)
    assert law.energy is not None
    with torch.no_grad():
        for power, value in zip(law.energy.exponents[:, 0].tolist(), law.energy.coefficients, strict=True):
            value.copy_(torch.tensor({2.0: 0.5, 4.0: 0.25}.get(power, 0.0)))
    move_rest_to_equilibrium(law)
    at_rest = linearize_modes(law, torch.zeros(0, dtype=torch.float64)).frequency_hz[0]
    period_frames = round(1.0 / (at_rest * DT_S))
    phase = 2 * np.pi * np.arange(3 * period_frames) / period_frames

    def quietest(amplitude: float) -> float:
        states = amplitude * np.sin(phase)[:, None]
        motion = EncodedTrajectory(
            states, np.zeros((len(phase), 0)), DT_S * np.arange(len(phase)), ((0, len(phase)),)
        )
        found = measure_quietest_frequency(law, motion, period_frames=period_frames)
        assert found is not None
        return found / at_rest

    assert quietest(0.01) == pytest.approx(1.0, abs=2e-3)
    # harmonic balance: omega^2 = 1 + 3/4 amplitude^2, of which damping takes some
    assert 1.005 < quietest(0.3) < np.sqrt(1.0 + 0.75 * 0.09)
    assert quietest(0.3) < quietest(0.6) < np.sqrt(1.0 + 0.75 * 0.36)


def test_a_frequency_is_counted_between_rises_and_none_is_told_of_creep_or_of_inputs_that_change() -> None:
    time_s = DT_S * np.arange(200)
    assert count_oscillations(np.sin(2 * np.pi * 0.7 * time_s - 1.0), dt_s=DT_S) == pytest.approx(
        0.7, rel=1e-3
    )
    assert count_oscillations(np.exp(-time_s), dt_s=DT_S) is None
    law, driven = random_lagrangian(1, 1, 0, terms="polynomial"), np.sin(time_s)[:, None]
    motion = EncodedTrajectory(driven, driven, time_s, ((0, 200),))
    assert measure_quietest_frequency(law, motion, period_frames=20) is None
