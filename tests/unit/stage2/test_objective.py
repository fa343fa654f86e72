"""Errors of forecasts."""

import pytest
import torch

from lagsplat.stage2.objective import add_ridge, one_step_error, square_norm
from lagsplat.stage2.rollout import ShootingWindows, rollout
from tests.stage2_problems import random_lagrangian


def test_ridge_caps_the_ratio_of_weights_and_keeps_the_trace() -> None:
    metric = torch.diag(torch.tensor([1e-6, 1.0, 3.0], dtype=torch.float64))
    got = add_ridge(metric, ridge=0.01)
    values = torch.linalg.eigvalsh(got)
    assert float(torch.trace(got)) == pytest.approx(3.0)
    assert float(values[-1] / values[0]) == pytest.approx(101.0, rel=1e-3)
    error = torch.tensor([[0.0, 2.0, 1.0]], dtype=torch.float64)
    assert float(square_norm(error, metric)) == pytest.approx(7.0)


def test_the_one_step_error_vanishes_on_the_systems_own_motion() -> None:
    lagrangian = random_lagrangian(2, 1, 0, amount=0.1)
    unit = float(lagrangian.time_unit_s)
    q, v = torch.randn(2, 3, 2, dtype=torch.float64)
    inputs = torch.rand(3, 5, 1, dtype=torch.float64)
    path, speed = rollout(lagrangian, q, v / unit, inputs, dt_s=0.1 * unit)
    metric = torch.eye(2, dtype=torch.float64)
    windows = ShootingWindows(
        q=q, v=v, u=inputs[:, 0], q_next=path[:, 1], v_next=speed[:, 1] * unit, step=0.1
    )
    assert float(one_step_error(lagrangian, windows, metric, velocity_weight=1.0).detach()) < 1e-20
