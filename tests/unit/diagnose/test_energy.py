"""Exponents of laws of friction that are known, and none where nothing dissipates."""

import numpy as np
import pytest

from lagsplat.diagnose.residual.energy import Cycles, cycles, dissipation
from lagsplat.diagnose.residual.latent_force import smooth
from tests.unit.diagnose.mechanisms import Duffing, film

FREE = Duffing(n_u=0, hard=0.0, damp=0.1)


def of(force, noise=0.003, mechanism=FREE):
    motion = film(mechanism, 20.0, start=(1.0,), force=force, noise=noise, finer=2)
    return cycles(smooth(mechanism, [motion], period_s=1.0), 0)


@pytest.mark.parametrize(
    ("force", "exponent"),
    [
        (lambda t, q, v, u: -0.4 * v, 2.0),
        (lambda t, q, v, u: -1.5 * np.tanh(v / 0.02), 1.0),
        (lambda t, q, v, u: -0.3 * np.abs(v) * v, 3.0),
    ],
    ids=["viscous", "coulomb", "quadratic"],
)
def test_laws_have_their_exponents(force, exponent):
    found = dissipation(of(force))
    assert found.low - 0.1 <= exponent <= found.high + 0.1
    assert found.exponent == pytest.approx(exponent, abs=0.25)
    assert found.high - found.low < 0.8
    assert not found.gained


def test_too_much_damping_in_the_sim_is_a_gain():
    assert dissipation(of(lambda t, q, v, u: 0.3 * v, mechanism=Duffing(n_u=0, hard=0.0))).gained


def test_work_of_a_viscous_force_is_its_closed_form():
    found = of(lambda t, q, v, u: -0.04 * v, noise=0.001)
    expected = np.pi * 0.02 * 2 * np.pi * found.frequency_hz * found.amplitude**2
    np.testing.assert_allclose(found.work[:8], expected[:8], rtol=0.1)
    assert found.work[:8].sum() == pytest.approx(expected[:8].sum(), rel=0.02)
    np.testing.assert_allclose(found.frequency_hz[:8], 1.0, rtol=0.03)


def test_intervals_hold_what_they_promise():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(60):
        amplitude = np.geomspace(1.0, 0.1, 15)
        std = 0.02 * amplitude + 1e-3
        work = 0.4 * amplitude**2 + std * rng.standard_normal(15)
        found = dissipation(Cycles(amplitude, work, std, np.ones(15)))
        held += found.low <= 2.0 <= found.high
    assert held >= 49


def test_nothing_is_said_of_noise_few_cycles_or_one_amplitude():
    rng = np.random.default_rng(1)
    amplitude = np.geomspace(1.0, 0.1, 15)
    said = 0
    for _ in range(100):
        said += (
            dissipation(Cycles(amplitude, 0.1 * rng.standard_normal(15), np.full(15, 0.1), amplitude))
            is not None
        )
    assert said <= 12  # two standard deviations
    assert dissipation(Cycles(amplitude[:5], amplitude[:5], 0.01 * amplitude[:5], amplitude[:5])) is None
    ones = np.ones(15)
    assert dissipation(Cycles(ones, ones, 0.01 * ones, ones)) is None
