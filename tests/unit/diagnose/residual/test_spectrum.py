"""Lines and coherence against residuals of known frequencies."""

import numpy as np
import pytest

from lagsplat.diagnose.residual.spectrum import compute_spectrum
from tests.unit.diagnose.residuals import made, no_force


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
    told = sum(bool(compute_spectrum([made(no_force, seed=seed)], period_s=1.0).lines) for seed in range(200))
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
        compute_spectrum([made(no_force, seed=seed)], period_s=1.0).coherence[:, 0, 0] for seed in range(60)
    ]
    assert np.mean(np.concatenate(noises) > found.significant) < 0.03


def test_short_clips_have_no_spectrum():
    assert compute_spectrum([made(no_force, 2.0)], period_s=1.0) is None
