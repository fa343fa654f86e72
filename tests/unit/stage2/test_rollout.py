import numpy as np
import pytest
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.rollout import cut_shooting_targets, list_one_step_windows, list_starts


def parabola(n: int, segments: tuple[tuple[int, int], ...]) -> EncodedTrajectory:
    """Position t^2, for which every stencil used is exact."""
    t = 0.1 * np.arange(n)
    return EncodedTrajectory((t**2)[:, None], t[:, None].copy(), t, segments)


def test_windows_hold_states_one_stride_apart_with_exact_velocities() -> None:
    windows = list_one_step_windows(parabola(30, ((0, 30),)), stride_frames=2, time_unit_s=0.5)
    assert windows.step == pytest.approx(0.4)
    t = windows.u[:, 0]
    torch.testing.assert_close(windows.q[:, 0], t**2)
    torch.testing.assert_close(windows.v[:, 0], 2 * t * 0.5)
    torch.testing.assert_close(windows.q_next[:, 0], (t + 0.2) ** 2)
    torch.testing.assert_close(windows.v_next[:, 0], 2 * (t + 0.2) * 0.5)
    assert len(windows) == 30 - 6
    assert len(windows.pick(torch.tensor([3, 4]))) == 2


def test_windows_do_not_cross_a_cut() -> None:
    at = list_starts(parabola(20, ((0, 8), (8, 20))), before=2, after=3)
    np.testing.assert_array_equal(at, [2, 3, 4, 10, 11, 12, 13, 14, 15, 16])
    with pytest.raises(ValueError, match="needs 7"):
        list_one_step_windows(parabola(10, ((0, 5), (5, 10))), stride_frames=2, time_unit_s=1.0)


def test_shots_follow_the_trajectory() -> None:
    trajectory = parabola(30, ((0, 30),))
    at = np.array([4, 9])
    taken = cut_shooting_targets(trajectory, at, n_states=5, time_unit_s=0.5)
    torch.testing.assert_close(taken.targets[1, :, 0], torch.from_numpy((0.1 * np.arange(9, 14)) ** 2))
    torch.testing.assert_close(taken.v[:, 0], torch.from_numpy(0.1 * at))


def test_an_uneven_clock_uses_the_true_times() -> None:
    rng = np.random.default_rng(0)
    t = 0.1 * (np.arange(40) + rng.uniform(-0.2, 0.2, 40))[rng.uniform(size=40) > 0.1]
    trajectory = EncodedTrajectory((t**2)[:, None], t[:, None].copy(), t, ((0, len(t)),))
    windows = list_one_step_windows(trajectory, stride_frames=2, time_unit_s=0.5)
    assert isinstance(windows.step, torch.Tensor)
    now, ahead = windows.u, windows.q_next.sqrt()
    torch.testing.assert_close(windows.step, (ahead - now) / 0.5)
    torch.testing.assert_close(windows.v, 2 * now * 0.5)
    torch.testing.assert_close(windows.v_next, 2 * ahead * 0.5)
    torch.testing.assert_close(windows.pick(torch.tensor([3, 4])).step, windows.step[3:5])
    at = np.array([4, 9])
    taken = cut_shooting_targets(trajectory, at, n_states=5, time_unit_s=0.5)
    torch.testing.assert_close(taken.v[:, 0], torch.from_numpy(0.5 * 2 * t[at]))
    assert isinstance(taken.steps, torch.Tensor)
    torch.testing.assert_close(taken.steps[1], torch.from_numpy(np.diff(t[9:14]) / 0.5))
