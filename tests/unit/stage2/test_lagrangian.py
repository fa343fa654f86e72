import numpy as np
import pytest
import torch

from lagsplat.stage2.lagrangian import Coefficients, find_equilibrium, linearize_modes
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


def test_equilibrium_balances_the_forces_of_a_learned_system() -> None:
    lagrangian = random_lagrangian(3, 2, 1)
    u = torch.rand(2, dtype=torch.float64)
    q = find_equilibrium(lagrangian, u)
    force = lagrangian.conservative_force(q[None], u[None], lagrangian.prepare())
    assert float(force.detach().abs().max()) < 1e-4
