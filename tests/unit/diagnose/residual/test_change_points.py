"""Events against residuals that begin and end at known times."""

import numpy as np
import pytest

from lagsplat.diagnose.residual.change_points import find_events
from lagsplat.diagnose.residual.latent_force import compute_coordinate_shares
from lagsplat.diagnose.residual.spectrum import compute_spectrum
from lagsplat.diagnose.residual.state_maps import find_state_regions
from tests.unit.diagnose.residuals import made, no_force


def test_two_pushes_are_two_events_with_their_times_and_shares():
    def pushes(t, q, v, u):
        return 3.0 * ((t > 4.0) & (t < 4.4)) + 2.0 * ((t > 11.0) & (t < 11.6))

    first, second = find_events([made(pushes)], period_s=1.0)
    assert (first.start_s, first.end_s) == (pytest.approx(4.0, abs=0.1), pytest.approx(4.4, abs=0.1))
    assert (second.start_s, second.end_s) == (pytest.approx(11.0, abs=0.1), pytest.approx(11.6, abs=0.1))
    assert first.share == pytest.approx(0.6, abs=0.05)
    assert second.share == pytest.approx(0.4, abs=0.05)


def test_an_onset_splits_a_recording():
    found = find_events([made(lambda t, q, v, u: -1.0 * q * (t > 9.0))], period_s=1.0)
    assert min(event.start_s for event in found) == pytest.approx(9.0, abs=0.6)
    assert max(event.end_s for event in found) > 19.0
    assert sum(event.share for event in found) > 0.9


def test_a_force_that_always_acts_fills_its_recording_and_only_it():
    quiet = made(no_force, seed=1)
    found = find_events([quiet, made(lambda t, q, v, u: -1.0 * q)], period_s=1.0)
    assert {event.motion for event in found} == {1}
    assert sum(event.end_s - event.start_s for event in found) > 16.0


def test_events_of_noise_are_rare():
    told = sum(bool(find_events([made(no_force, seed=seed)], period_s=1.0)) for seed in range(200))
    assert told <= 20  # 5 in 100 and two standard deviations


def test_no_kept_force_is_no_event_no_share_and_no_region():
    silent = made(no_force, quiet=(0,))
    assert find_events([silent], period_s=1.0) == []
    assert find_state_regions([silent], period_s=1.0) == ([], [])
    np.testing.assert_array_equal(compute_coordinate_shares([silent]), [0.0])
    assert compute_spectrum([silent], period_s=1.0).bands == ()


def test_shares_are_of_each_coordinates_own_swing():
    pair = made(
        lambda t, q, v, u: np.array([1.0, 2.0]) * np.sin(2 * np.pi * 3.0 * t), coordinates=2, std=0.01
    )
    swing = np.mean(pair.a**2, axis=0)
    expected = np.array([1.0, 4.0]) / swing
    np.testing.assert_allclose(compute_coordinate_shares([pair]), expected / expected.sum(), rtol=0.02)
