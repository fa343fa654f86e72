"""Intervals of a law's modes: they hold the truth as often as they say, also under coloured noise."""

import numpy as np
import pytest
import torch

from benchmarks.law_intervals import DECAY_PER_S, FREQUENCY_HZ, record
from lagsplat.stage2.config import LikelihoodConfig
from lagsplat.stage2.equilibrium import LinearizedModes, linearize_modes
from lagsplat.stage2.fit import fit_dynamics, load_parameter_draws, save_dynamics
from lagsplat.stage2.likelihood.multiple_shooting import WindowScores
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from lagsplat.stage2.likelihood.uncertainty import (
    draw_modes,
    draw_parameters,
    leave_out_windows,
    match_modes,
    measure_intervals,
)
from tests.stage2_problems import form
from tests.unit.stage2.test_fit import config

QUARTIC = form(terms="polynomial", potential_degree=4, input_degree=1, matrix_degree=0)


def test_intervals_hold_the_truth_and_a_file_keeps_the_draws(tmp_path) -> None:
    held = []
    for seed in range(3):
        motion = record(seed)
        settings = config(form=QUARTIC, likelihood=LikelihoodConfig(600, 8, 1.3, 4))
        law, report = fit_dynamics(motion, np.eye(1), settings, 0, rest=np.zeros(1), measured=motion)
        assert report.draws is not None
        still = torch.zeros(1, dtype=torch.float64)
        modes = linearize_modes(law, still)
        drawn = draw_modes(ParameterVector(law), report.draws, still)
        assert linearize_modes(law, still) == modes
        (frequency, decay), *_ = measure_intervals(modes, drawn)
        held.append([frequency[0] < FREQUENCY_HZ < frequency[1], decay[0] < DECAY_PER_S < decay[1]])
        assert frequency[1] - frequency[0] < 0.1 * FREQUENCY_HZ
    # of 3 intervals of 90 % fewer than 2 hold with a probability of 2.8 %
    assert (np.sum(held, axis=0) >= 2).all()
    save_dynamics(tmp_path / "dynamics.safetensors", law, {}, report)
    np.testing.assert_array_equal(load_parameter_draws(tmp_path / "dynamics.safetensors"), report.draws)


def test_draws_are_as_wide_as_blocks_disagree_and_a_prior_bounds_what_no_window_sees() -> None:
    rng = np.random.default_rng(0)
    scores = np.c_[rng.standard_normal((200, 1)), np.zeros((200, 1))]
    each = np.tile(np.diag([1.0, 0.0]), (200, 1, 1))
    window_scores = WindowScores(scores, each, np.diag([200.0, 1e-4]))
    theta = np.array([3.0, 5.0])
    left_out = theta + leave_out_windows(window_scores)
    draws = draw_parameters(theta, left_out, information=window_scores.information, seed=1)
    assert draws[:, 0].std() == pytest.approx(1 / np.sqrt(200), rel=0.3)
    assert draws[:, 1].std() == pytest.approx(100.0, rel=0.3)
    with pytest.raises(ValueError, match="1 window: a spread needs two"):
        leave_out_windows(WindowScores(scores[:1], each[:1], window_scores.information))


def test_modes_are_matched_by_their_eigenvalues_and_a_missing_one_has_no_decay() -> None:
    ours = LinearizedModes([0.0, 0.0], [1.0, 5.0], [0.1, 2.0])
    other = LinearizedModes([0.0, 0.0], [5.5, 1.1], [2.1, 0.2])
    np.testing.assert_allclose(match_modes(ours, other), [[1.1, 0.2], [5.5, 2.1]])
    alone = match_modes(ours, LinearizedModes([0.0], [4.0], [1.0]))
    assert alone[0, 0] == 0.0
    assert np.isnan(alone[0, 1])
    np.testing.assert_allclose(alone[1], [4.0, 1.0])


def test_an_interval_holds_its_own_value_and_a_mode_that_draws_lack_is_unknown() -> None:
    modes = LinearizedModes([0.0, 0.0], [5.0, 2.0], [1.0, 0.0])
    softer = LinearizedModes([0.0, 0.0], [4.99, 2.0], [1.0, 0.0])
    (frequency, decay), (unmoved, none) = measure_intervals(modes, [softer] * 20)
    assert frequency[0] < 5.0 < frequency[1]
    np.testing.assert_allclose(decay, [1.0, 1.0])
    np.testing.assert_allclose(unmoved, [2.0, 2.0])
    assert np.isnan(none).all()
    gone = LinearizedModes([0.0], [2.0], [0.0])
    (frequency, decay), _ = measure_intervals(modes, [softer] * 15 + [gone] * 5)
    assert frequency[1] > 1000 * 5.0 > 5.0 > 1000 * frequency[0]
    assert decay[1] > 1000.0
