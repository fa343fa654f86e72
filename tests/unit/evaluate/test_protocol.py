"""Starts, initial velocities, pinned divergence."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.evaluate.aggregate import group_windows
from lagsplat.evaluate.evaluate import make_integrator
from lagsplat.evaluate.protocol import (
    STENCILS,
    cut_windows,
    draw_starts,
    explain_shortage,
    initial_states,
    pin_diverged,
)
from tests.unit.evaluate.stand_ins import DT_S, cut, world
from tests.unit.evaluate.tiny_run import lagrangian


def test_starts_of_one_clip_are_the_published_draw_but_for_repeated_ones():
    held, _ = world()
    starts = draw_starts(held, length=30, margin=0, count=50, seed=0)
    published = np.random.default_rng(0).integers(40, 1500 - 30, size=50)
    assert len(np.unique(starts)) == 50
    once = list(dict.fromkeys(published))
    assert np.array_equal(starts[: len(once)], once)


def test_no_more_starts_than_there_are():
    held = cut(world()[0], 100)
    starts = draw_starts(replace(held, segments=((0, 100),)), length=50, margin=0, count=500, seed=0)
    assert sorted(starts) == list(range(held.skip, 50))


def test_windows_of_one_group_overlap_and_first_ones_do_not():
    starts = np.array([95, 0, 10, 29, 30, 64, 60])
    assert group_windows(starts, 30).tolist() == [3, 0, 0, 0, 1, 2, 2]


def test_starts_never_cross_a_cut_nor_enter_the_skip():
    held = cut(world()[0], 100, 130, 700)
    starts = draw_starts(held, length=30, margin=3, count=2000, seed=1)
    clip = np.searchsorted([100, 130, 700], starts, side="right")
    assert starts.min() >= held.skip
    assert np.array_equal(clip, np.searchsorted([100, 130, 700], starts + 32, side="right"))
    assert not np.any(clip == 1)


def test_no_room_is_explained():
    held = cut(world()[0], 20, 60)
    with pytest.raises(ValueError, match=r"1600 frames needs .* the longest has 1440"):
        draw_starts(held, length=1600, margin=3, count=5, seed=0)


def test_initial_velocity_is_second_order():
    held, _ = world()
    object.__setattr__(held, "encoded", np.stack([held.dt_s * np.arange(9.0)] * 2, axis=1) ** 2)
    _, velocity = initial_states(held, np.array([0, 3]))
    assert np.allclose(velocity, 2 * DT_S * np.array([[0.0, 0.0], [3.0, 3.0]]), atol=1e-12)


def test_divergence_is_pinned_for_good():
    rollouts = np.ones((4, 5, 2))
    rollouts[1, 2:] = np.nan
    rollouts[2, 3] = (30.0, 40.0)
    rollouts[3, 4] = (0.0, -np.inf)
    pinned, gone = pin_diverged(rollouts, bound=10.0)
    assert gone.sum(axis=1).tolist() == [0, 3, 2, 1]
    assert np.allclose(np.linalg.norm(pinned[gone], axis=1), 10.0)
    assert np.allclose(pinned[2, 3], (6.0, 8.0))
    assert np.allclose(pinned[2, 4], (6.0, 8.0))
    assert np.array_equal(pinned[~gone], rollouts[~gone])


def test_an_even_clock_written_out_changes_nothing():
    held, _ = world()
    written = replace(held, time_s=DT_S * np.arange(held.n_frames))
    starts = draw_starts(held, length=30, margin=0, count=50, seed=0)
    for ours, theirs in zip(initial_states(written, starts), initial_states(held, starts), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    law = lagrangian()
    q0, v0 = initial_states(held, starts)
    pushed = cut_windows(held.forcing, starts, 30)
    with_times, plain = (
        make_integrator(law)(q0, v0, pushed, clip.clock.steps_s(starts, 30)) for clip in (written, held)
    )
    np.testing.assert_allclose(with_times, plain, rtol=1e-9, atol=1e-9)


def test_central_velocities_are_of_fourth_order_and_need_frames_on_either_side():
    held = replace(cut(world()[0], 100, 104), stencil=STENCILS["central"], skip=0)
    cubic = (held.dt_s * np.arange(float(held.n_frames)))[:, None] ** 4 * np.ones(2)
    object.__setattr__(held, "encoded", cubic)
    _, velocity = initial_states(held, np.array([40]))
    np.testing.assert_allclose(velocity, 4 * (40 * DT_S) ** 3, rtol=1e-9)
    assert [start for start, _ in held.clips] == [2, 102, 106]
    starts = draw_starts(held, length=30, margin=0, count=500, seed=0)
    assert starts.min() >= 2
    assert not np.any((starts >= 98) & (starts < 106))


def test_neighbours_agree_with_a_coarse_step():
    """A harmonic law of one Verlet step a frame, three frames a period, continues exactly from them."""
    step, turn = 1.9, 2 * np.arcsin(0.95)
    path = np.cos(turn * np.arange(12.0))
    velocity = (path[2:] - path[:-2]) / (2 * step)
    half = velocity - 0.5 * step * path[1:-1]
    np.testing.assert_allclose(path[1:-1] + step * half, path[2:], atol=1e-12)


def test_a_shortage_is_told_before_it_is_an_error():
    held, _ = world()
    assert explain_shortage(held, length=30, margin=0) == ""
    assert "needs a held-out clip of more than 9000 frames" in explain_shortage(held, length=9000, margin=0)
