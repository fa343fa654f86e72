"""Free segments and windows."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.evaluate.free_motion import cut_free_windows, find_free_segments
from tests.unit.evaluate.stand_ins import DT_S, cut, integrate, settings, world


def ramp_world():
    """A drive, a pause of 3 s, a drive, a slow ramp of 5 s, and a tail of 4 s."""
    rng = np.random.default_rng(0)
    held, _ = world()
    inputs = np.concatenate(
        [
            rng.uniform(size=300),
            np.full(180, 0.4),
            rng.uniform(size=300),
            np.linspace(0.0, 1.0, 300),
            [0.3, 0.6],
            np.zeros(240),
        ]
    )[:, None]
    series = {name: getattr(held, name)[: len(inputs)] for name in ("encoded", "latents")}
    return replace(held, inputs=inputs, forcing=inputs, segments=((0, len(inputs)),), **series)


def test_pauses_are_found_longest_first_and_ramps_are_not_free():
    segments = find_free_segments(ramp_world(), settings())
    assert segments == [(1082, 1322), (300, 480)]


def test_at_most_so_many():
    assert find_free_segments(ramp_world(), settings(free_max_segments=1)) == [(1082, 1322)]


def test_without_inputs_every_clip_is_free_from_the_skip_on():
    held = cut(world(inputs=False)[0], 100, 500)
    assert find_free_segments(held, settings()) == [(500, 1500), (100, 500)]


def test_excursion_is_limited_within_a_slow_drift():
    held, _ = world()
    drift = np.concatenate([np.linspace(0, 1, 1000), np.zeros(500)])[:, None]
    segments = find_free_segments(replace(held, inputs=drift), settings(free_min_s=0.5))
    assert segments[0] == (1000, 1500)
    assert all(np.ptp(drift[start:stop]) < 0.05 for start, stop in segments)


def test_windows_tile_the_tail_and_start_from_the_encoded_state():
    held, _ = world()
    windows, reason = cut_free_windows(held, integrate, settings())
    assert reason == ""
    assert len({len(window.encoded.states) for window in windows}) == 1
    assert len(windows[0].encoded.states) == pytest.approx(8 / (1.4 * DT_S), rel=0.02)
    assert windows[0].start == 900
    for window in windows:
        assert np.allclose(window.rollout.states[0], window.encoded.states[0])
    assert windows[0].encoded.peak.visible_hz == pytest.approx(1.4, rel=0.01)
    assert windows[0].rollout.modes[0].rate_per_s == pytest.approx(0.4, rel=0.02)


def test_quiet_windows_are_left_out():
    """After five seconds the tail is down to e^-2, after ten to e^-4."""
    held, _ = world(frames=2400, tail=1400)
    windows, _ = cut_free_windows(held, integrate, settings())
    assert 1 <= len(windows) <= 2
    assert windows[0].start == 1000


def test_no_window_has_a_reason():
    held, _ = world()
    busy = replace(held, inputs=np.random.default_rng(0).uniform(size=(1500, 1)))
    windows, reason = cut_free_windows(busy, integrate, settings())
    assert windows == []
    assert "stands still for 2.0 s" in reason
    still = replace(held, encoded=held.encoded * np.r_[np.ones(900), np.zeros(600)][:, None])
    windows, reason = cut_free_windows(still, integrate, settings())
    assert windows == []
    assert "none with an oscillation" in reason


def test_an_uneven_clock_is_seen_through() -> None:
    """The same tail filmed with a fifth of jitter and every twentieth frame dropped: the same oscillation."""
    rng = np.random.default_rng(0)
    time_s = DT_S * (np.arange(600) + rng.uniform(-0.2, 0.2, 600))[rng.uniform(size=600) > 0.05]
    omega, rate = 2 * np.pi * 1.4, 0.4
    q = np.exp(-rate * time_s) * np.cos(omega * time_s)
    series, n = np.stack([np.zeros_like(q), q], axis=1), len(q)
    still = np.zeros((n, 0))
    film = replace(
        world()[0], encoded=series, latents=series, forcing=still, inputs=still, segments=((0, n),), skip=0
    )

    def simulate(q0, v0, inputs, steps_s):
        later = np.concatenate([np.zeros((len(q0), 1)), np.cumsum(steps_s, axis=1)], axis=1)[..., None]
        size = (v0 + rate * q0)[:, None] / omega
        return np.exp(-rate * later) * (q0[:, None] * np.cos(omega * later) + size * np.sin(omega * later))

    windows, _ = cut_free_windows(replace(film, time_s=time_s), simulate, settings())
    assert windows
    for window in windows:
        for motion in (window.encoded, window.rollout):
            assert motion.modes[0].frequency_hz == pytest.approx(1.4, rel=0.005)
            assert motion.modes[0].rate_per_s == pytest.approx(0.4, rel=0.02)
        assert window.encoded.peak.visible_hz == pytest.approx(1.4, rel=0.01)
        encoded, rolled_out = window.encoded.states, window.rollout.states
        np.testing.assert_allclose(rolled_out, encoded, atol=0.05 * np.abs(encoded).max())

    def even(q0, v0, inputs, dt_s):
        return simulate(q0, v0, inputs, np.full((len(q0), inputs.shape[1] - 1), dt_s))

    taken_for_even, _ = cut_free_windows(film, even, settings())
    assert abs(taken_for_even[0].encoded.modes[0].frequency_hz / 1.4 - 1) > 0.02
