"""Second recordings of the arm: nothing planted is the arm itself, and what is planted acts as it says."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.systems.arm import build_arm
from lagsplat.systems.config import PlantedEffectConfig, PlantedRecordingsConfig
from lagsplat.systems.simulate import lag_input, simulate, simulate_planted

NOTHING = PlantedEffectConfig(tip_mass=0.0, actuator_lag_s=0.0, dry_friction=0.0)


@pytest.fixture(scope="module")
def config():
    toy = compose("profile=toy", "system=toy").simulation
    return replace(toy, n_frames=240, rest_frames=20, hold_frames=20, tail_frames=60, camera_noise_levels=0.0)


def test_nothing_planted_is_the_arm_before_its_own_background(config):
    """Under other pressures, but at rest before them: the same picture, to the grey level."""
    own, _ = simulate(config, seed=0)
    again = simulate_planted(config, NOTHING, seed=1, scene=0)
    np.testing.assert_array_equal(again.frames[0], own.frames[0])
    assert not np.array_equal(again.inputs, own.inputs)
    assert again.meta["sha256"] != own.meta["sha256"]


def test_nothing_planted_moves_as_the_arm_does(config):
    """The same drive through both programs gives the same film."""
    own, truth = simulate(config, seed=1)
    again = simulate_planted(config, NOTHING, seed=1, scene=1)
    assert np.abs(again.frames.astype(int) - own.frames.astype(int)).max() <= 1
    assert np.ptp(truth.states, axis=0).max() > 0.1


def test_a_load_hangs_deeper(config):
    loaded = replace(NOTHING, tip_mass=0.2)
    arm = build_arm(config.arm)
    heavy = build_arm(replace(config.arm, link_mass=[config.arm.link_mass[0] + 0.2]))
    assert heavy.equilibrium(np.zeros(2))[1] > arm.equilibrium(np.zeros(2))[1]
    bare, with_load = (simulate_planted(config, one, seed=1, scene=0) for one in (NOTHING, loaded))
    assert not np.array_equal(bare.frames[0], with_load.frames[0])
    np.testing.assert_array_equal(bare.inputs, with_load.inputs)


def test_dry_friction_stills_the_tail(config):
    bare, rubbing = (
        simulate_planted(config, replace(NOTHING, dry_friction=amount), seed=1, scene=0).frames.astype(float)
        for amount in (0.0, 0.2)
    )
    moves = [np.abs(np.diff(film[-30:], axis=0)).mean() for film in (bare, rubbing)]
    assert moves[1] < 0.1 * moves[0]


def test_a_lag_is_that_of_its_differential_equation():
    dt_s, lag_s = 0.01, 0.2
    ramp = np.stack([np.arange(200) * dt_s, np.ones(200)], axis=1)
    time_s = dt_s * np.arange(200)
    felt = lag_input(ramp, lag_s=lag_s, dt_s=dt_s)
    np.testing.assert_allclose(felt[:, 0], time_s - lag_s * (1 - np.exp(-time_s / lag_s)), atol=1e-9)
    np.testing.assert_allclose(felt[:, 1], 1.0 - np.exp(-time_s / lag_s), atol=1e-9)
    assert lag_input(ramp, lag_s=0.0, dt_s=dt_s) is ramp


def test_what_cannot_be_planted_is_refused():
    with pytest.raises(ValueError, match="tip_mass"):
        replace(NOTHING, tip_mass=-0.1)
    with pytest.raises(ValueError, match="choose another"):
        PlantedRecordingsConfig(n_frames=100, seed=0, effects={})
