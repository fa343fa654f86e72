from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.objective import anchor_law, anchored_error
from tests.stage2_problems import random_lagrangian

METRIC = torch.eye(2, dtype=torch.float64)


def clip() -> EncodedTrajectory:
    rng = np.random.default_rng(0)
    time_s = 0.02 * np.arange(400)
    latents = np.stack((3 * np.sin(5 * time_s), 1 + np.cos(7 * time_s)), 1)
    return EncodedTrajectory(latents, rng.uniform(size=(400, 1)), time_s, ((0, 200), (200, 400)))


def test_the_law_itself_costs_nothing_and_another_one_does() -> None:
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


def test_only_the_law_that_is_fitted_is_pulled() -> None:
    lagrangian = random_lagrangian(2, 1, 0, amount=0.1)
    anchor = anchor_law(lagrangian, clip())
    with torch.no_grad():
        lagrangian.rest += 0.1
    anchor.penalty(lagrangian, METRIC, np.random.default_rng(0)).backward()
    assert lagrangian.rest.grad is not None
    assert float(lagrangian.rest.grad.abs().sum()) > 0
    assert all(parameter.grad is None for parameter in anchor.start.parameters())


def test_states_are_drawn_around_the_clip_at_its_own_speed() -> None:
    trajectory, lagrangian = clip(), random_lagrangian(2, 1, 0, amount=0.1)
    anchor = anchor_law(lagrangian, trajectory)
    assert anchor.middle.numpy() == pytest.approx(trajectory.latents.mean(0))
    assert anchor.spread.numpy() == pytest.approx(trajectory.latents.std(0), rel=1e-2)
    unit = float(lagrangian.time_unit_s)
    # rms speeds of 3 sin 5t and cos 7t
    assert anchor.speed.numpy() == pytest.approx(unit * np.array([15.0, 7.0]) / np.sqrt(2), rel=0.05)


def test_it_never_steps_from_one_segment_to_the_next() -> None:
    trajectory, lagrangian = clip(), random_lagrangian(2, 1, 0, amount=0.1)
    moved = trajectory.latents.copy()
    moved[200:] += 1e3
    speed = anchor_law(lagrangian, replace(trajectory, latents=moved)).speed
    assert speed.numpy() == pytest.approx(anchor_law(lagrangian, trajectory).speed.numpy())


def test_the_better_the_frames_are_followed_the_less_the_start_weighs() -> None:
    """Errors in another unit are minimised by the same law: only their ratio to the present one counts."""
    x = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    slopes = []
    for unit in (1.0, 1e-4):
        error, penalty = unit * (1.0 + (x - 1.0) ** 2), x**2
        whole = anchored_error(error, penalty, weight=0.5)
        slopes.append(torch.autograd.grad(whole, x)[0] / error.detach())
    wanted = torch.autograd.grad(torch.log(1.0 + (x - 1.0) ** 2) + 0.5 * x**2, x)[0]
    assert [float(slope) for slope in slopes] == pytest.approx([float(wanted)] * 2)
