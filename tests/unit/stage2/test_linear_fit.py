from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.stage2.config import FloorConfig
from lagsplat.stage2.input_stiffness import InputRange
from lagsplat.stage2.lagrangian import Coefficients, Lagrangian
from lagsplat.stage2.linear_fit import (
    ConstantFit,
    assemble_step_matrices,
    evaluate_one_step_error,
    evaluate_shooting_error,
)
from lagsplat.stage2.rollout import ShootingTargets, ShootingWindows, rollout, verlet_step
from tests.stage2_problems import random_lagrangian, split

CONSTANT = {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"}
ONE_SIGN = InputRange(torch.ones(1, dtype=torch.float64), torch.zeros(1, dtype=torch.float64))


def coefficients_of(lagrangian: Lagrangian) -> Coefficients:
    q = torch.zeros(1, lagrangian.d, dtype=torch.float64)
    bent, none = lagrangian.prepare().curvature, torch.zeros(lagrangian.n_inputs, dtype=torch.float64)
    input_range = InputRange(none + 1.0, none)
    return Coefficients(
        lagrangian.mass(q)[0].detach(),
        lagrangian.damping(q)[0].detach(),
        lagrangian.prepare().stiffness.detach(),
        lagrangian.pressure_map.detach(),
        lagrangian.rest.detach(),
        None if bent is None else split(bent.detach(), input_range),
    )


def own_shots(lagrangian: Lagrangian, batch: int, n: int) -> ShootingTargets:
    """Rollouts of a system itself from random states under steady random inputs, 0.05 units apart."""
    unit, rng = float(lagrangian.time_unit_s), torch.Generator().manual_seed(0)
    q, v = torch.randn(2, batch, lagrangian.d, generator=rng, dtype=torch.float64)
    inputs = torch.rand(batch, 1, lagrangian.n_inputs, generator=rng, dtype=torch.float64).expand(-1, n, -1)
    path, _ = rollout(lagrangian, q, v / unit, inputs, dt_s=0.05 * unit)
    return ShootingTargets(q, v, inputs, path, 0.05)


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
    q, v = torch.randn(2, 200, 2, dtype=torch.float64)
    u = torch.rand(200, 1, dtype=torch.float64)
    with torch.no_grad():
        q_next, v_next = verlet_step(lagrangian, q, v, u, step=0.1, ready=lagrangian.prepare())
    windows = ShootingWindows(q=q, v=v, u=u, q_next=q_next, v_next=v_next, step=0.1)
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


@pytest.mark.parametrize("bent", [False, True])
def test_shooting_error_vanishes_on_its_own_rollout(bent: bool) -> None:
    lagrangian = random_lagrangian(2, 1, 1, **CONSTANT | ({"actuation": "bounded"} if bent else {}))
    if lagrangian.volume_net is not None:
        torch.nn.init.zeros_(lagrangian.volume_net.head)
    shots, metric = own_shots(lagrangian, 3, 12), torch.eye(2, dtype=torch.float64)
    assert (coefficients_of(lagrangian).input_stiffness is not None) == bent
    off = replace(shots, targets=shots.targets + 1.0)
    c = coefficients_of(lagrangian)
    own, wrong = (float(evaluate_shooting_error(c, s, metric).detach()) for s in (shots, off))
    assert own < 0.05 * wrong


def test_curvatures_fit_what_a_linear_map_cannot() -> None:
    """A system whose input softens it, from a start that knows no curvature."""
    eye = torch.eye(2, dtype=torch.float64)
    start = Coefficients(
        eye,
        0.3 * eye,
        3 * eye,
        2 * torch.ones(1, 2, dtype=torch.float64),
        0 * eye[0],
        split(torch.diag(torch.tensor([-1.5, 2.0], dtype=torch.float64))[None], ONE_SIGN),
    )
    lagrangian = random_lagrangian(
        2, 1, 0, start=start, amount=0.0, **CONSTANT | {"actuation": "bounded", "damping": "constant"}
    )
    shots, metric = own_shots(lagrangian, 60, 40), torch.eye(2, dtype=torch.float64)
    fit = ConstantFit(start.rest, 1, floor=FloorConfig(1e-3, 1e-4, 1e-3), learn_rest=True)
    linear = fit.minimize(lambda c: evaluate_shooting_error(c, shots, metric), iterations=200)
    fit.add_input_stiffness(ONE_SIGN, softening=True, rng=np.random.default_rng(0))
    bent = fit.minimize(lambda c: evaluate_shooting_error(c, shots, metric), iterations=200)
    found, floors = fit.result()
    assert bent < 0.1 * linear
    assert found.input_stiffness is not None
    assert float(torch.linalg.eigvalsh(found.input_stiffness.curvature[0])[0]) < -0.5
    # one equilibrium up to the largest load
    assert (
        float(torch.linalg.eigvalsh(found.stiffness + found.input_stiffness.curvature[0])[0])
        > floors.stiffness
    )


def test_rollouts_that_overflow_do_not_abort_the_fit() -> None:
    lagrangian = random_lagrangian(2, 1, 1, **CONSTANT)
    shots, metric = own_shots(lagrangian, 3, 12), torch.eye(2, dtype=torch.float64)
    fit = ConstantFit(
        torch.zeros(2, dtype=torch.float64), 1, floor=FloorConfig(1e-3, 1e-4, 1e-3), learn_rest=True
    )
    calls = []

    def sometimes_overflows(c: Coefficients) -> torch.Tensor:
        calls.append(0)
        error = evaluate_shooting_error(c, shots, metric)
        return error * float("inf") if len(calls) == 4 else error

    reached = fit.minimize(sometimes_overflows, iterations=30)
    assert len(calls) > 6
    assert np.isfinite(reached)
