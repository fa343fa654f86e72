import numpy as np
import pytest
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.evaluate.free_motion import compute_linear_modes
from lagsplat.stage2.amplitude import measure_quietest_frequency
from lagsplat.stage2.equilibrium import (
    NoEquilibriumError,
    find_equilibrium,
    linearize_modes,
    move_rest_to_equilibrium,
)
from lagsplat.stage2.fit import FitReport
from lagsplat.stage2.lagrangian import Coefficients
from lagsplat.stage2.likelihood.fitted_law import MOST_PIECES, set_time_scales
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from lagsplat.stage2.likelihood.uncertainty import draw_modes
from tests.stage2_problems import random_lagrangian


def test_modes_of_a_constant_oscillator_are_the_textbook_ones() -> None:
    def one(x: float) -> torch.Tensor:
        return torch.tensor([[x]], dtype=torch.float64)

    start = Coefficients(one(2.0), one(0.4), one(8.0), one(3.0), one(0.5)[0])
    lagrangian = random_lagrangian(1, 1, 0, start=start, amount=0.0)
    unit = float(lagrangian.time_unit_s)
    found = linearize_modes(lagrangian, torch.tensor([1.0], dtype=torch.float64))
    assert found.decay_per_s == pytest.approx([0.1 / unit])
    assert found.frequency_hz == pytest.approx([np.sqrt(4.0 - 0.01) / (2 * np.pi * unit)])
    assert found.equilibrium == pytest.approx([0.5 + 3.0 / 8.0])


def test_a_law_without_an_equilibrium_is_refused_and_its_measures_are_missing() -> None:
    law = random_lagrangian(1, 0, 0, amount=0.0, terms="polynomial", potential_degree=2)
    assert law.energy is not None
    with torch.no_grad():
        for power, value in zip(law.energy.exponents[:, 0].tolist(), law.energy.coefficients, strict=True):
            value.copy_(torch.tensor({1.0: 1.0}.get(power, 0.0)))  # a slope without an end
    for find in (find_equilibrium, linearize_modes, move_rest_to_equilibrium):
        with pytest.raises(NoEquilibriumError, match="no equilibrium was reached"):
            find(law)
    assert compute_linear_modes(law) == []
    assert draw_modes(ParameterVector(law), np.zeros((3, 3)), torch.zeros(0, dtype=torch.float64)) == []
    period = np.sin(np.arange(40))[:, None]
    motion = EncodedTrajectory(period, np.zeros((40, 0)), 0.1 * np.arange(40), ((0, 40),))
    assert measure_quietest_frequency(law, motion, period_frames=6) is None
    assert set_time_scales(law, motion, period_frames=6) == 6
    assert law.longest_step * float(law.time_unit_s) == pytest.approx(0.1 / MOST_PIECES)
    assert "no rest state without inputs" in FitReport(unsettled="why", equilibria=1).warnings[0]


def test_equilibrium_balances_the_forces_of_a_learned_system() -> None:
    lagrangian = random_lagrangian(3, 2, 1)
    u = torch.rand(2, dtype=torch.float64)
    q = find_equilibrium(lagrangian, u)
    force = lagrangian.conservative_force(q[None], u[None], lagrangian.prepare())
    assert float(force.detach().abs().max()) < 1e-12
