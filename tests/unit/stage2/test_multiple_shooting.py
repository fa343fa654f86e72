"""Windows, derivatives and normal equations of multiple shooting, by finite differences and dense solves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.monomials import draw_states, make_wide_ball
from lagsplat.normal_equations import solve_normal
from lagsplat.stage2.likelihood import multiple_shooting
from lagsplat.stage2.likelihood.guard import MAP_STATES, STATES, Guard
from lagsplat.stage2.likelihood.multiple_shooting import MultipleShooting
from lagsplat.stage2.likelihood.parameter_vector import MAP, ParameterVector
from lagsplat.stage2.likelihood.prior import make_prior
from lagsplat.stage2.likelihood.windows import choose_stretches, cut_windows
from lagsplat.stage2.rollout import rollout, rollout_in_torch
from tests.stage2_problems import random_lagrangian

DT_S = 0.02


def trajectory(frames: int = 40) -> EncodedTrajectory:
    time_s = DT_S * np.arange(frames)
    latents = np.stack([np.sin(9.0 * time_s), np.cos(7.0 * time_s)], axis=1)
    return EncodedTrajectory(latents, np.sin(3.0 * time_s)[:, None], time_s, ((0, 25), (25, frames)))


def problem(coupling: float = 0.1) -> tuple[MultipleShooting, torch.Tensor, torch.Tensor]:
    lagrangian = random_lagrangian(2, 1, 3, amount=0.05, terms="polynomial", map_degree=2)
    motion = trajectory()
    windows = cut_windows(motion, motion.segments, n=4, time_unit_s=0.1, longest_step=0.15)
    parameters = ParameterVector(lagrangian)
    shooting = MultipleShooting(
        parameters,
        windows,
        noise=np.full(2, 0.1),
        memory=np.array([0.0, 0.6]),
        coupling=np.full(4, coupling),
        prior=make_prior(parameters),
        guard=Guard(parameters, motion, seed=0),
    )
    starts = torch.from_numpy(np.concatenate([motion.latents, 0.0 * motion.latents], axis=1)[windows.frames])
    return shooting, shooting.parameters.read(), starts


def test_windows_follow_one_another_within_a_segment() -> None:
    shooting, _, _ = problem()
    assert shooting.windows.frames.tolist() == [0, 4, 8, 12, 16, 20, 25, 29, 33]
    assert shooting.windows.linked.tolist() == [True] * 5 + [False] + [True] * 2 + [False]
    assert shooting.windows.inputs.shape == (9, 4, 5, 1)
    with pytest.raises(ValueError, match=r"25 frames and a window of the fit needs 31"):
        cut_windows(trajectory(), trajectory().segments, n=30, time_unit_s=0.1, longest_step=1.0)


def test_stretches_are_spread_over_the_recording() -> None:
    assert choose_stretches([(0, 50), (60, 90)], frames=100) == [(0, 50), (60, 90)]
    chosen = choose_stretches([(0, 1000), (1000, 4000)], frames=800)
    assert chosen[0][0] == 0
    assert chosen[-1][1] == 4000
    assert sum(stop - start for start, stop in chosen) == 800
    assert all(b <= c for (_, b), (c, _) in pairwise(chosen))


def test_derivatives_are_those_of_the_rollout() -> None:
    shooting, theta, starts = problem()
    path = shooting.parameters.roll_out(theta, starts, shooting.windows)
    by_start, by_theta, last = shooting.parameters.differentiate(theta, path, shooting.windows)
    step = 1e-6
    n_map = len(shooting.parameters.find_columns(MAP))
    assert by_theta.shape[3] == len(theta) - n_map
    for k in range(by_theta.shape[3]):
        away = torch.zeros_like(theta)
        away[n_map + k] = step
        ends = [
            shooting.parameters.roll_out(theta + sign * away, starts, shooting.windows) for sign in (1, -1)
        ]
        change = (ends[0] - ends[1]) / (2 * step)
        torch.testing.assert_close(change[:, :-1, :2], by_theta[..., k], rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(change[:, -1], last[..., k], rtol=1e-5, atol=1e-6)
    away = torch.zeros_like(starts)
    away[:, 3] = step
    ends = [shooting.parameters.roll_out(theta, starts + sign * away, shooting.windows) for sign in (1, -1)]
    torch.testing.assert_close((ends[0] - ends[1]) / (2 * step), by_start[..., 3], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("d", [1, 3])
@pytest.mark.parametrize("reach", [0.5, 5.0])  # states inside and outside the ball
def test_compiled_rollouts_are_those_of_the_law(d: int, reach: float) -> None:
    law = random_lagrangian(d, 2, 7, amount=0.02, terms="polynomial", map_degree=1, matrix_degree=2)
    states = draw_states(make_wide_ball(d, 1.0), 30, reach=reach, seed=1)
    law.move_ball(draw_states(make_wide_ball(d, 1.0), 300, reach=1.0, seed=2))
    inputs = torch.randn(30, 6, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    expected = rollout_in_torch(law, states, 0.3 * states, inputs, dt_s=0.01)
    found = rollout(law, states, 0.3 * states, inputs, dt_s=0.01)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-11, atol=1e-11)


def test_latents_are_observed_and_differentiated_through_the_map() -> None:
    shooting, theta, starts = problem()
    parameters, x = shooting.parameters, starts[:, None, :2]
    q = parameters.observe(theta, x, x)
    torch.testing.assert_close(parameters.coordinates.evaluate(q[:, 0])[0], x[:, 0])
    by_x, by_map = parameters.differentiate_observation(theta, q)
    step, columns = 1e-6, parameters.find_columns(MAP)
    away = torch.zeros_like(theta)
    away[columns[1]] = step
    ends = [parameters.observe(theta + sign * away, x, q) for sign in (1, -1)]
    torch.testing.assert_close((ends[0] - ends[1]) / (2 * step), by_map[..., 1], rtol=1e-5, atol=1e-7)
    away = step * torch.tensor([0.0, 1.0]).double()
    ends = [parameters.observe(theta, x + sign * away, q) for sign in (1, -1)]
    torch.testing.assert_close((ends[0] - ends[1]) / (2 * step), by_x[..., 1], rtol=1e-5, atol=1e-7)


def test_a_guard_asks_for_a_stiffness_and_a_map_that_does_not_fold() -> None:
    shooting, theta, _ = problem()
    guard, (energy, _, _) = shooting.guard, shooting.parameters.terms
    assert guard is not None
    stiffness, stretch = guard.measure(torch.zeros_like(theta))[0].split([STATES + 1, MAP_STATES])
    assert torch.all(stiffness > 2.0)
    assert not stretch.any()
    folded = theta.clone()
    folded[shooting.parameters.find_columns(MAP)] = -5.0
    assert guard.measure(folded)[0][-MAP_STATES:].any()
    assert not guard.add_folds(shooting.parameters.coordinates)
    shooting.parameters.write(folded)
    assert guard.add_folds(shooting.parameters.coordinates)
    assert len(guard.measure(folded)[0]) > STATES + 1 + MAP_STATES
    shooting.parameters.write(theta)
    with torch.no_grad():
        energy.set_quadratic(torch.eye(2).double(), torch.zeros(2).double(), torch.ones(1, 2).double())
    lacking, rows = guard.measure(shooting.parameters.read())
    assert not lacking.any()
    assert not rows.any()


def test_elimination_gives_the_step_of_the_whole_system() -> None:
    shooting, theta, starts = problem()
    now = shooting.evaluate(theta, starts)
    normal = shooting.assemble(theta, now, shooting.differentiate(theta, now))
    k, s = normal.states_gradient.shape
    p = len(theta)
    whole = np.zeros((k * s + p, k * s + p))
    for i in range(k):
        here, there = slice(i * s, (i + 1) * s), slice((i + 1) * s, (i + 2) * s)
        whole[here, here] = normal.states[i]
        if shooting.windows.linked[i]:
            whole[here, there] = normal.link[i]
            whole[there, here] = normal.link[i].T
        whole[here, k * s :] = normal.mixed[i]
        whole[k * s :, here] = normal.mixed[i].T
    whole[k * s :, k * s :] = normal.parameters
    gradient = np.concatenate([normal.states_gradient.ravel(), normal.parameters_gradient])
    wanted = np.linalg.solve(whole + 1e-3 * np.diag(np.diag(whole)), -gradient)
    step = solve_normal(normal, damping=1e-3)
    assert step is not None
    found = np.concatenate([step[0].ravel(), step[1]])
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)


def test_a_gradient_is_that_of_the_cost() -> None:
    shooting, theta, starts = problem()
    now = shooting.evaluate(theta, starts)
    normal = shooting.assemble(theta, now, shooting.differentiate(theta, now))
    step = 1e-6
    for k in (0, len(theta) - 1):
        away = torch.zeros_like(theta)
        away[k] = step
        costs = [shooting.evaluate(theta + sign * away, starts).cost for sign in (1, -1)]
        slope = normal.parameters_gradient[k]
        assert (costs[0] - costs[1]) / (2 * step) == pytest.approx(slope, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("kick", [0.0, 0.2])
def test_the_evidence_tells_whether_the_motion_follows_the_law(kick: float) -> None:
    """A free oscillation, with or without kicks between the windows, in coloured noise."""
    lagrangian = random_lagrangian(2, 1, 3, amount=0.0, terms="polynomial")
    rng, time_s = np.random.default_rng(0), DT_S * np.arange(201)
    shapes = EncodedTrajectory(np.ones((201, 2)), np.zeros((201, 1)), time_s, ((0, 201),))
    windows = cut_windows(shapes, shapes.segments, n=20, time_unit_s=0.1, longest_step=0.3)
    parameters, state = ParameterVector(lagrangian), torch.tensor([[1.0, -0.5, 0.0, 0.3]]).double()
    starts, targets = [], []
    for _ in range(len(windows.frames)):
        state = state + kick * torch.from_numpy(rng.standard_normal((1, 4)))
        starts.append(state)
        path = parameters.roll_out(
            parameters.read(), state, replace(windows, inputs=windows.inputs[:1], steps=windows.steps[:1])
        )
        targets.append(path[:, :, :2])
        state = path[:, -1]
    noise = lfilter([0.02], [1.0, -0.7], rng.standard_normal((10, 21, 2)), axis=1)
    seen = replace(windows, targets=torch.cat(targets) + torch.from_numpy(noise))
    evidence = []
    for coupling in (0.2, 0.01):
        parameters = ParameterVector(lagrangian)
        shooting = MultipleShooting(
            parameters,
            seen,
            prior=make_prior(parameters),
            noise=np.full(2, 0.028),
            memory=np.full(2, 0.7),
            coupling=np.full(4, coupling),
        )
        fitted = shooting.fit(torch.cat(starts), iterations=4, least_gain=0.1)
        evidence.append(shooting.measure_evidence(fitted))
    assert (evidence[0] > evidence[1] + 5.0) == (kick > 0.0)
    assert (evidence[1] > evidence[0] + 5.0) == (kick == 0.0)
    if not kick:
        assert fitted.memory == pytest.approx(0.7, abs=0.2)


def test_a_fit_lowers_the_cost_and_a_divergence_is_none() -> None:
    shooting, theta, starts = problem()
    before = shooting.evaluate(theta, starts).cost
    fit = shooting.fit(starts, iterations=3, least_gain=0.1)
    assert fit.cost < 0.5 * before
    assert 0 < fit.steps <= 3
    assert shooting.evaluate(theta, starts * 1e200).cost == float("inf")


def test_a_fit_that_holds_the_law_moves_the_starts_alone() -> None:
    shooting, theta, starts = problem()
    before = shooting.evaluate(theta, starts).cost
    fit = shooting.fit(starts, iterations=3, least_gain=0.1, hold_law=True)
    assert fit.cost < before
    assert torch.equal(shooting.parameters.read(), theta)
    assert not torch.equal(fit.starts, starts)


def test_a_step_bends_with_the_valley(monkeypatch: pytest.MonkeyPatch) -> None:
    """To second order: what a step misses of its linear forecast shrinks faster than without the bend."""
    shooting, theta, starts = problem()
    starts = shooting.fit(starts, iterations=20, least_gain=0.1, hold_law=True).starts
    now = shooting.evaluate(theta, starts)
    slopes = shooting.differentiate(theta, now)
    normal = shooting.assemble(theta, now, slopes)
    costs = []
    for most_turn in (multiple_shooting.MOST_TURN, 0.0):
        monkeypatch.setattr(multiple_shooting, "MOST_TURN", most_turn)
        step = shooting._step(theta, starts, now, slopes, normal, damping=1.0, hold_law=False)
        plain = solve_normal(normal, damping=1.0)
        assert plain is not None
        states, law = step or [torch.from_numpy(part) for part in plain]
        costs.append(shooting.evaluate(theta + law, starts + states).cost)
    assert step is None  # every bend is refused
    assert costs[0] < costs[1] < now.cost
