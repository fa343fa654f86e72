from dataclasses import replace

import numpy as np
import torch

from lagsplat.stage2.config import FloorConfig
from lagsplat.stage2.lagrangian import Coefficients, Lagrangian
from lagsplat.stage2.linear_fit import (
    ConstantFit,
    assemble_step_matrices,
    evaluate_one_step_error,
)
from lagsplat.stage2.rollout import ShootingWindows, verlet_step
from tests.stage2_problems import random_lagrangian

CONSTANT = {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"}


def coefficients_of(lagrangian: Lagrangian) -> Coefficients:
    q = torch.zeros(1, lagrangian.d, dtype=torch.float64)
    return Coefficients(
        lagrangian.mass(q)[0].detach(),
        lagrangian.damping(q)[0].detach(),
        lagrangian.prepare().stiffness.detach(),
        lagrangian.pressure_map.detach(),
        lagrangian.rest.detach(),
    )


def list_windows(lagrangian: Lagrangian, batch: int, step: float | torch.Tensor) -> ShootingWindows:
    """Steps of a system itself from random states under random inputs."""
    rng = torch.Generator().manual_seed(0)
    q, v = torch.randn(2, batch, lagrangian.d, generator=rng, dtype=torch.float64)
    u = torch.rand(batch, lagrangian.n_inputs, generator=rng, dtype=torch.float64)
    with torch.no_grad():
        q_next, v_next = verlet_step(lagrangian, q, v, u, step=step, ready=lagrangian.prepare())
    return ShootingWindows(q=q, v=v, u=u, q_next=q_next, v_next=v_next, step=step)


def test_step_matrices_are_the_verlet_step_of_a_constant_system() -> None:
    lagrangian = random_lagrangian(3, 2, 0, **CONSTANT)
    c = coefficients_of(lagrangian)
    q, v = torch.randn(2, 6, 3, dtype=torch.float64)
    u = torch.rand(6, 2, dtype=torch.float64)
    transition, entry = assemble_step_matrices(c, 0.2)
    push = (u @ c.pressure_map + c.rest @ c.stiffness) @ torch.linalg.inv(c.mass)
    got = torch.cat([q, v], 1) @ transition + push @ entry
    want = torch.cat(verlet_step(lagrangian, q, v, u, step=0.2, ready=lagrangian.prepare()), 1)
    torch.testing.assert_close(got, want)


def test_fit_recovers_the_step_of_a_constant_system_and_keeps_its_floors() -> None:
    lagrangian = random_lagrangian(2, 1, 4, **CONSTANT)
    windows = list_windows(lagrangian, 200, 0.1)
    fit = ConstantFit(
        torch.zeros(2, dtype=torch.float64), 1, floor=FloorConfig(1e-3, 1e-4, 1e-3), learn_rest=True
    )
    metric = torch.eye(2, dtype=torch.float64)
    reached = fit.minimize(
        lambda c: evaluate_one_step_error(c, windows, metric, velocity_weight=1.0), iterations=500
    )
    found, floors = fit.result()
    assert reached < 1e-6
    torch.testing.assert_close(
        assemble_step_matrices(found, 0.1)[0],
        assemble_step_matrices(coefficients_of(lagrangian), 0.1)[0],
        rtol=1e-2,
        atol=1e-2,
    )
    assert abs(float(torch.trace(found.mass)) - 2.0) < 1e-9
    assert float(torch.linalg.eigvalsh(found.damping)[0]) >= floors.damping


def test_steps_that_differ_in_length_have_no_error_on_their_own_motion() -> None:
    lagrangian = random_lagrangian(2, 1, 1, **CONSTANT)
    steps = torch.linspace(0.05, 0.2, 7, dtype=torch.float64)[:, None]
    windows, metric = list_windows(lagrangian, 7, steps), torch.eye(2, dtype=torch.float64)
    c = coefficients_of(lagrangian)
    own = evaluate_one_step_error(c, windows, metric, velocity_weight=1.0)
    assert float(own.detach()) < 1e-20
    longer = replace(windows, step=1.1 * steps)
    assert float(evaluate_one_step_error(c, longer, metric, velocity_weight=1.0).detach()) > 1e-6


def test_steps_that_overflow_do_not_abort_the_fit() -> None:
    lagrangian = random_lagrangian(2, 1, 1, **CONSTANT)
    windows, metric = list_windows(lagrangian, 30, 0.1), torch.eye(2, dtype=torch.float64)
    fit = ConstantFit(
        torch.zeros(2, dtype=torch.float64), 1, floor=FloorConfig(1e-3, 1e-4, 1e-3), learn_rest=True
    )
    calls = []

    def sometimes_overflows(c: Coefficients) -> torch.Tensor:
        calls.append(0)
        error = evaluate_one_step_error(c, windows, metric, velocity_weight=1.0)
        return error * float("inf") if len(calls) == 4 else error

    reached = fit.minimize(sometimes_overflows, iterations=30)
    assert len(calls) > 6
    assert np.isfinite(reached)
