"""Stiffness that depends on the inputs."""

import pytest
import torch

from lagsplat.stage2.input_stiffness import (
    SMALLEST,
    InputRange,
    InputStiffnessPrior,
    stiffen,
    stiffness_penalty,
)
from tests.stage2_problems import bent, split


def problem() -> tuple[torch.Tensor, torch.Tensor]:
    input_stiffness = bent(3, 2, torch.Generator().manual_seed(0))
    return input_stiffness.curvature, input_stiffness.input_range.positive


def test_a_curvature_is_reproduced_and_its_softening_compensated() -> None:
    curvature, largest = problem()
    got, compensation = InputStiffnessPrior(
        split(curvature, InputRange(2 * largest, 0 * largest)), softening=True
    ).matrices()
    torch.testing.assert_close(got, curvature, atol=3 * SMALLEST, rtol=0)
    values, vectors = torch.linalg.eigh(curvature)
    softer = (vectors * (-values).clamp(min=0)[..., None, :]) @ vectors.mT
    torch.testing.assert_close(
        compensation, stiffness_penalty(softer, 2 * largest), atol=10 * SMALLEST, rtol=0
    )
    for u in (torch.zeros(3), torch.tensor([2.0, 0.0, 1.0]), 2 * torch.ones(3)):
        loaded = compensation + (u[:, None, None].double() * got).sum(0)
        assert float(torch.linalg.eigvalsh(loaded.detach())[0]) > -1e-9


def test_without_softening_volumes_are_concave_without_compensation() -> None:
    curvature, largest = problem()
    got, compensation = InputStiffnessPrior(
        split(curvature, InputRange(largest, 0 * largest)), softening=False
    ).matrices()
    assert float(torch.linalg.eigvalsh(got.detach()).min()) > 0
    assert float(compensation.abs().max()) == 0


def test_a_zero_curvature_still_has_a_gradient() -> None:
    curvature, largest = problem()
    module = InputStiffnessPrior(split(0 * curvature, InputRange(largest, 0 * largest)), softening=True)
    matrices, compensation = module.matrices()
    (matrices[0, 0, 1] + compensation[0, 1]).backward()
    assert module.softening is not None
    for factor in (module.stiffening, module.softening):
        assert factor.grad is not None
        assert float(factor.grad.abs().max()) > 1e-3


def test_the_force_is_that_of_the_sum_of_the_loaded_curvatures() -> None:
    curvature, _ = problem()
    u = torch.tensor([[1.0, 2.0, 0.5]], dtype=torch.float64)
    offset = torch.tensor([[0.3, -0.7]], dtype=torch.float64)
    want = (u[0, 0] * curvature[0] + u[0, 1] * curvature[1] + u[0, 2] * curvature[2]) @ offset[0]
    assert stiffen(u, curvature, offset)[0].numpy() == pytest.approx(want.numpy())
