"""Errors of forecasts, and the penalty that anchors a law."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.objective import (
    add_ridge,
    anchor_law,
    anchored_error,
    one_step_error,
    shooting_error,
    square_norm,
)
from lagsplat.stage2.rollout import ShootingTargets, ShootingWindows, rollout
from tests.stage2_problems import random_lagrangian


def test_ridge_caps_the_ratio_of_weights_and_keeps_the_trace() -> None:
    metric = torch.diag(torch.tensor([1e-6, 1.0, 3.0], dtype=torch.float64))
    got = add_ridge(metric, ridge=0.01)
    values = torch.linalg.eigvalsh(got)
    assert float(torch.trace(got)) == pytest.approx(3.0)
    assert float(values[-1] / values[0]) == pytest.approx(101.0, rel=1e-3)
    error = torch.tensor([[0.0, 2.0, 1.0]], dtype=torch.float64)
    assert float(square_norm(error, metric)) == pytest.approx(7.0)


def test_both_errors_vanish_on_the_systems_own_motion() -> None:
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
    assert (
        float(shooting_error(lagrangian, ShootingTargets(q, v, inputs, path, 0.1), metric).detach()) < 1e-20
    )


METRIC = torch.eye(2, dtype=torch.float64)


def clip() -> EncodedTrajectory:
    rng = np.random.default_rng(0)
    time_s = 0.02 * np.arange(400)
    latents = np.stack((3 * np.sin(5 * time_s), 1 + np.cos(7 * time_s)), 1)
    return EncodedTrajectory(latents, rng.uniform(size=(400, 1)), time_s, ((0, 200), (200, 400)))


def test_the_anchor_law_has_no_penalty_and_another_law_has_one() -> None:
    lagrangian = random_lagrangian(2, 1, 0, amount=0.1)
    anchor = anchor_law(lagrangian, clip())
    assert float(anchor.penalty(lagrangian, METRIC, np.random.default_rng(0)).detach()) < 1e-25
    with torch.no_grad():
        lagrangian.rest += 0.1
    once = anchor.penalty(lagrangian, METRIC, np.random.default_rng(0))
    assert float(once.detach()) > 1e-4
    with torch.no_grad():
        lagrangian.rest += 0.1
    assert float(anchor.penalty(lagrangian, METRIC, np.random.default_rng(0)).detach()) > 2 * float(
        once.detach()
    )


def test_only_the_fitted_law_receives_gradients() -> None:
    lagrangian = random_lagrangian(2, 1, 0, amount=0.1)
    anchor = anchor_law(lagrangian, clip())
    with torch.no_grad():
        lagrangian.rest += 0.1
    anchor.penalty(lagrangian, METRIC, np.random.default_rng(0)).backward()
    assert lagrangian.rest.grad is not None
    assert float(lagrangian.rest.grad.abs().sum()) > 0
    assert all(parameter.grad is None for parameter in anchor.start.parameters())


def test_states_are_sampled_around_the_clip_at_its_speed() -> None:
    trajectory, lagrangian = clip(), random_lagrangian(2, 1, 0, amount=0.1)
    anchor = anchor_law(lagrangian, trajectory)
    assert anchor.middle.numpy() == pytest.approx(trajectory.latents.mean(0))
    assert anchor.spread.numpy() == pytest.approx(trajectory.latents.std(0), rel=1e-2)
    unit = float(lagrangian.time_unit_s)
    # rms speeds of 3 sin 5t and cos 7t
    assert anchor.speed.numpy() == pytest.approx(unit * np.array([15.0, 7.0]) / np.sqrt(2), rel=0.05)


def test_the_speed_ignores_jumps_between_segments() -> None:
    trajectory, lagrangian = clip(), random_lagrangian(2, 1, 0, amount=0.1)
    moved = trajectory.latents.copy()
    moved[200:] += 1e3
    speed = anchor_law(lagrangian, replace(trajectory, latents=moved)).speed
    assert speed.numpy() == pytest.approx(anchor_law(lagrangian, trajectory).speed.numpy())


def test_the_penalty_is_relative_to_the_error() -> None:
    """Errors in another unit are minimised by the same law: only their ratio to the present one counts."""
    x = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    slopes = []
    for unit in (1.0, 1e-4):
        error, penalty = unit * (1.0 + (x - 1.0) ** 2), x**2
        whole = anchored_error(error, penalty, weight=0.5)
        slopes.append(torch.autograd.grad(whole, x)[0] / error.detach())
    wanted = torch.autograd.grad(torch.log(1.0 + (x - 1.0) ** 2) + 0.5 * x**2, x)[0]
    assert [float(slope) for slope in slopes] == pytest.approx([float(wanted)] * 2)
