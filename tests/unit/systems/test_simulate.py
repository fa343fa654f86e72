import numpy as np
import pytest

from lagsplat.systems.arm import build_arm
from lagsplat.systems.rendering.painting import paint_arm, paint_board
from lagsplat.systems.simulate import simulate


@pytest.fixture(scope="module")
def toy(load):
    return load("toy"), *simulate(load("toy"), seed=3)


def test_schema_of_the_recording(toy):
    config, recording, _ = toy
    assert recording.frames.shape == (config.n_frames, config.height, config.width, 3)
    assert recording.frames.dtype == np.uint8
    assert recording.dt_s == pytest.approx(config.dt_s)
    assert recording.input_names == ("p1", "p2")
    assert recording.input_units == ("atm", "atm")
    assert recording.meta["origin"] == "simulated"
    assert recording.states is None
    assert len(recording.meta["sha256"]) == 64


def test_one_seed_one_recording(load, toy):
    _, recording, truth = toy
    again, truth_again = simulate(load("toy"), seed=3)
    assert np.array_equal(recording.frames, again.frames)
    assert np.array_equal(recording.inputs, again.inputs)
    assert np.array_equal(truth.states, truth_again.states)
    other = simulate(load("toy"), seed=4)[0]
    assert not np.array_equal(recording.inputs, other.inputs)
    assert recording.meta["sha256"] == again.meta["sha256"] != other.meta["sha256"]


def test_noise_of_gauge_and_camera_has_its_size_and_spares_the_arm(load, toy):
    config, recording, truth = toy
    assert np.std(recording.inputs - truth.pressures) == pytest.approx(config.pressure_noise_atm, rel=0.1)
    still = recording.frames[: config.rest_frames].astype(float)
    rounded = np.hypot(config.camera_noise_levels, 1 / np.sqrt(12))
    assert np.sqrt(still.var(axis=0, ddof=1).mean()) == pytest.approx(rounded, rel=0.1)
    quiet, quiet_truth = simulate(load("toy", pressure_noise_atm=0.0, camera_noise_levels=0.0), seed=3)
    assert np.array_equal(quiet_truth.states, truth.states)
    assert np.array_equal(quiet.inputs, truth.pressures)


def test_frames_show_the_true_states(load):
    config = load("toy", camera_noise_levels=0.0)
    recording, truth = simulate(config, seed=0)
    background = np.random.default_rng(np.random.SeedSequence(0).spawn(4)[3])
    board = paint_board(config, generator=background)
    images = paint_arm(build_arm(config.arm), truth.states, config, board)
    assert np.abs(255 * images - recording.frames).max() <= 0.501


def test_rest_drive_and_free_decay(toy):
    config, _, truth = toy
    release = config.n_frames - config.tail_frames
    assert np.array_equal(truth.states[: config.rest_frames], np.tile(truth.rest, (config.rest_frames, 1)))
    assert np.degrees(truth.states[config.rest_frames : release, 0].std()) > 8
    assert np.all(truth.pressures[release + 8 :] == 0)
    energy = (truth.kinetic_energy + truth.potential_energy)[release + 8 :]
    assert np.all(np.diff(energy) < 0)
