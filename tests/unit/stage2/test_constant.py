import torch

from lagsplat.stage2.config import FloorConfig
from lagsplat.stage2.constant import (
    ConstantFit,
    linear_one_step_error,
    linear_shooting_error,
    step_matrices,
)
from lagsplat.stage2.integrate import verlet_step
from lagsplat.stage2.lagrangian import Coefficients
from lagsplat.stage2.rollout import rollout
from lagsplat.stage2.windows import Shots, Windows
from tests.stage2_problems import random_lagrangian

CONSTANT = {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"}


def coefficients_of(lagrangian) -> Coefficients:
    q = torch.zeros(1, lagrangian.d, dtype=torch.float64)
    return Coefficients(
        lagrangian.mass(q)[0].detach(),
        lagrangian.damping(q)[0].detach(),
        lagrangian.prepare().stiffness.detach(),
        lagrangian.pressure_map.detach(),
        lagrangian.rest.detach(),
    )


def test_step_matrices_are_the_verlet_step_of_a_constant_system() -> None:
    lagrangian = random_lagrangian(3, 2, 0, **CONSTANT)
    c = coefficients_of(lagrangian)
    q, v = torch.randn(2, 6, 3, dtype=torch.float64)
    u = torch.rand(6, 2, dtype=torch.float64)
    transition, entry = step_matrices(c, 0.2)
    push = (u @ c.pressure_map + c.rest @ c.stiffness) @ torch.linalg.inv(c.mass)
    got = torch.cat([q, v], 1) @ transition + push @ entry
    want = torch.cat(verlet_step(lagrangian, q, v, u, step=0.2, ready=lagrangian.prepare()), 1)
    torch.testing.assert_close(got, want)


def test_fit_recovers_the_step_of_a_constant_system_and_keeps_its_floors() -> None:
    lagrangian = random_lagrangian(2, 1, 4, **CONSTANT)
    q, v = torch.randn(2, 200, 2, dtype=torch.float64)
    u = torch.rand(200, 1, dtype=torch.float64)
    with torch.no_grad():
        q_next, v_next = verlet_step(lagrangian, q, v, u, step=0.1, ready=lagrangian.prepare())
    windows = Windows(q=q, v=v, u=u, q_next=q_next, v_next=v_next, step=0.1)
    fit = ConstantFit(
        torch.zeros(2, dtype=torch.float64), 1, floor=FloorConfig(1e-3, 1e-4, 1e-3), learn_rest=True
    )
    metric = torch.eye(2, dtype=torch.float64)
    reached = fit.minimize(
        lambda c: linear_one_step_error(c, windows, metric, velocity_weight=1.0), iterations=500
    )
    found, floors = fit.result()
    assert reached < 1e-6
    torch.testing.assert_close(
        step_matrices(found, 0.1)[0], step_matrices(coefficients_of(lagrangian), 0.1)[0], rtol=1e-2, atol=1e-2
    )
    assert abs(float(torch.trace(found.mass)) - 2.0) < 1e-9
    assert float(torch.linalg.eigvalsh(found.damping)[0]) >= floors.damping


def test_shooting_error_vanishes_on_its_own_rollout() -> None:

    lagrangian = random_lagrangian(2, 1, 1, **CONSTANT)
    unit = float(lagrangian.time_unit_s)
    q, v = torch.randn(2, 3, 2, dtype=torch.float64)
    inputs = torch.rand(3, 12, 1, dtype=torch.float64)
    path, _ = rollout(lagrangian, q, v / unit, inputs, dt_s=0.05 * unit)
    c = coefficients_of(lagrangian)
    metric = torch.eye(2, dtype=torch.float64)
    own = linear_shooting_error(c, Shots(q, v, inputs, path), metric, step=0.05)
    off = linear_shooting_error(c, Shots(q, v, inputs, path + 1.0), metric, step=0.05)
    assert float(own) < 0.05 * float(off)
