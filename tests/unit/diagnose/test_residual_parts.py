"""Time, frequency and state of residuals that are written down; and silence about those that are noise."""

import numpy as np
import pytest

from lagsplat.diagnose.residual.change_points import find_events
from lagsplat.diagnose.residual.latent_force import compute_coordinate_shares
from lagsplat.diagnose.residual.spectrum import compute_spectrum
from lagsplat.diagnose.residual.state_maps import find_state_regions
from tests.unit.diagnose.residuals import made


def nothing(t, q, v, u):
    return 0.0 * q


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
    quiet = made(nothing, seed=1)
    found = find_events([quiet, made(lambda t, q, v, u: -1.0 * q)], period_s=1.0)
    assert {event.motion for event in found} == {1}
    assert sum(event.end_s - event.start_s for event in found) > 16.0


def test_events_of_noise_are_rare():
    told = sum(bool(find_events([made(nothing, seed=seed)], period_s=1.0)) for seed in range(200))
    assert told <= 20  # 5 in 100 and two standard deviations


def test_no_kept_force_is_no_event_no_share_and_no_region():
    silent = made(nothing, quiet=(0,))
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


@pytest.mark.parametrize("hertz", [0.553, 2.3, 4.71])
def test_a_line_is_found_at_its_frequency(hertz):
    found = compute_spectrum(
        [made(lambda t, q, v, u: 0.5 * np.sin(2 * np.pi * hertz * t + 0.3))], period_s=1.0
    )
    assert found.lines[0].frequency_hz == pytest.approx(hertz, abs=0.02)
    low, high, share = found.bands[0]
    assert low < hertz < high
    assert share > 0.8


def test_lines_in_noise_are_rare():
    told = sum(bool(compute_spectrum([made(nothing, seed=seed)], period_s=1.0).lines) for seed in range(200))
    assert told <= 8  # 1 in 100, two standard deviations, and the windows' overlap


def test_coherence_is_with_what_drives_and_its_threshold_holds():
    found = compute_spectrum([made(lambda t, q, v, u: 2.0 * u)], period_s=1.0)
    assert found.names == ("u0", "v_q0")
    power, coherence = found.power[:, 0], found.coherence[:, 0]
    from_input, from_velocity = power @ np.where(coherence > found.significant, coherence, 0.0) / power.sum()
    assert from_input > 0.9
    assert from_velocity < 0.5
    # of independent noises, squared coherence exceeds the threshold at 1 in 100 frequencies
    noises = [
        compute_spectrum([made(nothing, seed=seed)], period_s=1.0).coherence[:, 0, 0] for seed in range(60)
    ]
    assert np.mean(np.concatenate(noises) > found.significant) < 0.03


def test_short_clips_have_no_spectrum():
    assert compute_spectrum([made(nothing, 2.0)], period_s=1.0) is None


def test_a_wall_has_its_region():
    found, maps = find_state_regions(
        [made(lambda t, q, v, u: -8.0 * np.maximum(q - 0.8, 0.0), 60.0)], period_s=1.0
    )
    profile = next(one for one in found if one.velocity is None)
    assert profile.share > 0.5
    assert 0.3 < profile.position[0] < 0.95
    assert profile.mean < 0.0
    assert {len(one.velocity_edges) for one in maps} == {2, 9}


def test_friction_has_a_region_on_either_side_of_rest():
    found, _ = find_state_regions([made(lambda t, q, v, u: -np.tanh(v / 0.1), 40.0)], period_s=1.0)
    boxes = [one for one in found if one.velocity is not None]
    assert {np.sign(one.mean) for one in boxes} == {-1.0, 1.0}
    for one in boxes:
        assert np.sign(np.mean(one.velocity)) == -np.sign(one.mean)
    assert sum(one.share for one in boxes) > 0.5


def test_regions_of_noise_are_rare_and_few_blocks_say_nothing():
    told = sum(
        bool(find_state_regions([made(nothing, seed=seed)], period_s=1.0, seed=seed)[0]) for seed in range(60)
    )
    assert told <= 7
    assert find_state_regions([made(lambda t, q, v, u: 3.0 + 0.0 * q, 3.0)], period_s=1.0)[0] == []
