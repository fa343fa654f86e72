"""Stiffness that depends on the inputs."""

import numpy as np
import pytest
import torch

from lagsplat.stage2.config import FloorConfig
from lagsplat.stage2.input_stiffness import (
    SMALLEST,
    InputRange,
    InputStiffnessPrior,
    measure_input_range,
    stiffen,
    stiffness_penalty,
)
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian
from lagsplat.stage2.linear_fit import ConstantFit, evaluate_shooting_error
from lagsplat.stage2.rollout import ShootingTargets, rollout
from tests.stage2_problems import bent, form, split


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


QUADRATIC = {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "bounded"}


def law(start: Coefficients, floors: Floors) -> Lagrangian:
    return Lagrangian(start, form=form(**QUADRATIC), floors=floors, time_unit_s=1.0, seed=0, signed=True)


def test_a_stiffness_proportional_to_the_torque_is_recovered() -> None:
    """Stiffer under a positive torque and softer under a negative one, in one coordinate, and the reverse in
    another."""
    eye, none = torch.eye(2, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
    input_stiffness = split(
        torch.diag(torch.tensor([1.2, -0.8], dtype=torch.float64))[None], InputRange(none + 1, none + 1)
    )
    truth = law(
        Coefficients(
            eye, 0.3 * eye, 3 * eye, torch.ones(1, 2, dtype=torch.float64), 0 * eye[0], input_stiffness
        ),
        Floors(1e-3, 1e-4, 1e-3),
    )
    rng = torch.Generator().manual_seed(0)
    q, v = torch.randn(2, 60, 2, generator=rng, dtype=torch.float64)
    held = 2 * torch.rand(60, 1, 1, generator=rng, dtype=torch.float64) - 1
    inputs = held.expand(-1, 40, -1)
    path, _ = rollout(truth, q, v, inputs, dt_s=0.05)
    shots, metric = ShootingTargets(q, v, inputs, path, 0.05), eye
    fit = ConstantFit(0 * eye[0], 1, floor=FloorConfig(1e-3, 1e-4, 1e-3), learn_rest=True)
    linear = fit.minimize(lambda c: evaluate_shooting_error(c, shots, metric), iterations=150)
    fit.add_input_stiffness(
        measure_input_range(held[:, 0].numpy()), softening=True, rng=np.random.default_rng(0)
    )
    bent = fit.minimize(lambda c: evaluate_shooting_error(c, shots, metric), iterations=200)
    assert bent < 0.1 * linear
    found, floors = fit.result()
    assert found.input_stiffness is not None
    per_mass = found.input_stiffness.curvature[0] @ torch.linalg.inv(found.mass)
    torch.testing.assert_close(per_mass, input_stiffness.curvature[0], atol=0.15, rtol=0)
    for u in (-1.0, 1.0):
        loaded = found.stiffness + u * found.input_stiffness.curvature[0]
        assert float(torch.linalg.eigvalsh(loaded)[0]) > 0
    # the law that starts from the fit keeps it
    again, _ = rollout(law(found, floors), q, v, inputs, dt_s=0.05)
    assert float((again - path).square().mean()) < 1e-2 * float(path.square().mean())
