"""The fixed-step integrator against its claimed order and against an adaptive one."""

import math

import numpy as np
import torch
from torch import Tensor
from torchdiffeq import odeint

from lagsplat.stage2.rollout import rollout, split_inputs
from tests.stage2_problems import random_lagrangian


def exact(lagrangian, q: Tensor, v: Tensor, u: Tensor, end: float) -> Tensor:
    """Position after ``end`` internal time units under a constant input, by dopri5."""
    d = q.shape[1]
    ready = lagrangian.prepare()

    def rate(_: Tensor, state: Tensor) -> Tensor:
        x, w = state[:, :d], state[:, d:]
        return torch.cat([w, lagrangian.acceleration(x, w, u, ready=ready)], 1)

    with torch.no_grad():
        times = torch.tensor([0.0, end], dtype=torch.float64)
        return odeint(rate, torch.cat([q, v], 1), times, rtol=1e-10, atol=1e-12)[-1, :, :d]


def errors_of_steps(lagrangian, q: Tensor, v: Tensor, u: Tensor, steps: np.ndarray) -> list[float]:
    """Distance from `exact` after half a time unit, for each length of the steps."""
    unit, truth = float(lagrangian.time_unit_s), exact(lagrangian, q, v, u, 0.5)
    errors = []
    for step in steps:
        held = u[:, None].expand(-1, round(0.5 / step) + 1, -1)
        path, _ = rollout(lagrangian, q, v / unit, held, dt_s=float(step) * unit)
        errors.append(float((path[:, -1] - truth).norm()))
    return errors


def test_error_against_dopri5_falls_as_the_square_of_the_step() -> None:
    lagrangian = random_lagrangian(3, 2, 1, amount=0.2)
    q, v = 0.5 * torch.randn(2, 4, 3, dtype=torch.float64)
    u = torch.rand(4, 2, dtype=torch.float64)
    steps = np.array([0.02, 0.01, 0.005])
    errors = errors_of_steps(lagrangian, q, v, u, steps)
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(slope - 2.0) < 0.15
    assert errors[-1] < 1e-3


def test_polynomial_laws_are_integrated_to_the_fourth_order() -> None:
    lagrangian = random_lagrangian(2, 2, 1, amount=0.1, terms="polynomial")
    q, v = 0.3 * torch.randn(2, 4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    u = 0.3 * torch.rand(4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    steps = np.array([0.1, 0.05, 0.025])
    errors = errors_of_steps(lagrangian, q, v, u, steps)
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 3.7


def test_uneven_steps_are_of_second_order_too_for_each_row_its_own() -> None:
    lagrangian = random_lagrangian(3, 2, 1, amount=0.2)
    unit, rng = float(lagrangian.time_unit_s), np.random.default_rng(0)
    q, v = 0.5 * torch.randn(2, 4, 3, dtype=torch.float64)
    u = torch.rand(4, 2, dtype=torch.float64)
    ends = torch.linspace(0.3, 0.5, 4, dtype=torch.float64)
    truth = torch.cat([exact(lagrangian, q[[i]], v[[i]], u[[i]], float(ends[i])) for i in range(4)])
    counts, errors = np.array([25, 50, 100]), []
    for n in counts:
        share = torch.from_numpy(rng.uniform(0.8, 1.2, (4, n)))
        share[:, ::10] *= 2.0  # a dropped frame
        steps = share / share.sum(1, keepdim=True) * ends[:, None]
        path, _ = rollout(lagrangian, q, v / unit, u[:, None].expand(-1, n + 1, -1), dt_s=steps * unit)
        errors.append(float((path[:, -1] - truth).norm()))
    assert abs(np.polyfit(np.log(counts), np.log(errors), 1)[0] + 2.0) < 0.2
    assert errors[-1] < 1e-3
    even, _ = rollout(lagrangian, q, v / unit, u[:, None].expand(-1, 9, -1), dt_s=0.01 * unit)
    for steps in (torch.full((8,), 0.01), torch.full((4, 8), 0.01)):
        same, _ = rollout(lagrangian, q, v / unit, u[:, None].expand(-1, 9, -1), dt_s=steps.double() * unit)
        torch.testing.assert_close(same, even, rtol=1e-6, atol=1e-8)


def test_inputs_are_held_over_the_step_that_follows_them() -> None:
    lagrangian = random_lagrangian(2, 1, 2)
    q = torch.zeros(1, 2, dtype=torch.float64)
    inputs = torch.zeros(1, 3, 1, dtype=torch.float64)
    changed = inputs.clone()
    changed[0, 1] = 1.0
    a, _ = rollout(lagrangian, q, q, inputs, dt_s=1e-3)
    b, _ = rollout(lagrangian, q, q, changed, dt_s=1e-3)
    torch.testing.assert_close(a[:, :2], b[:, :2])
    assert float((a[:, 2] - b[:, 2]).norm()) > 0
    changed[0, 1], changed[0, 2] = 0.0, 5.0
    torch.testing.assert_close(rollout(lagrangian, q, q, changed, dt_s=1e-3)[0], a)


def test_a_diverged_row_is_nan_from_there_on_and_spares_the_others() -> None:
    lagrangian = random_lagrangian(2, 0, 3, amount=0.05)
    q = torch.tensor([[0.1, 0.2], [1e200, 1e200]], dtype=torch.float64)
    path, speed = rollout(lagrangian, q, 1e200 * q, torch.zeros(2, 5, 0, dtype=torch.float64), dt_s=1e3)
    broken = torch.isnan(path).any(2)
    assert bool(broken[1, -1])
    first = int(broken[1].long().argmax())
    assert bool(torch.isnan(path[1, first:]).all())
    assert bool(torch.isnan(speed[1, first:]).all())
    calm, _ = rollout(lagrangian, q[:1], 0 * q[:1], torch.zeros(1, 5, 0, dtype=torch.float64), dt_s=1e-3)
    assert bool(torch.isfinite(calm).all())


def test_frames_far_apart_take_steps_enough_to_keep_the_frequency() -> None:
    """Five frames a radian: one step a frame is off by two thousandths of the phase, eight are not."""
    lagrangian = random_lagrangian(3, 2, 1, amount=0.2)
    unit = float(lagrangian.time_unit_s)
    q, v = 0.5 * torch.randn(2, 4, 3, dtype=torch.float64)
    u = torch.rand(4, 2, dtype=torch.float64)
    truth, errors = exact(lagrangian, q, v, u, 0.8), []
    for longest in (math.inf, 0.2, 0.025):
        lagrangian.longest_step = longest
        path, _ = rollout(lagrangian, q, v / unit, u[:, None].expand(-1, 5, -1), dt_s=0.2 * unit)
        errors.append(float((path[:, -1] - truth).norm()))
    assert errors[0] == errors[1]
    assert errors[2] < errors[1] / 40
    assert [split_inputs(0.2, longest) for longest in (math.inf, 0.2, 0.19, 0.025)] == [1, 1, 2, 8]
