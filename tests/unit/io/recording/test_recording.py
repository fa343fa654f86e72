"""Recordings: rules of the fields, cutting, splitting, keeping."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.io.recording.recording import SCHEMA, Recording, load_recording, save_recording


@pytest.fixture
def recording() -> Recording:
    rng = np.random.default_rng(0)
    return Recording(
        frames=rng.integers(0, 256, (20, 4, 5, 3), dtype=np.uint8),
        time_s=0.1 * np.arange(20),
        inputs=rng.normal(size=(20, 2)),
        input_names=("p1", "p2"),
        input_units=("atm", "atm"),
        segments=((0, 8), (8, 20)),
        states=rng.normal(size=(20, 3)),
        meta={"origin": "simulated", "source": "twin.npz"},
    )


def test_round_trip_with_lazy_frames(recording: Recording, tmp_path: Path) -> None:
    save_recording(tmp_path / "r.safetensors", recording)
    loaded = load_recording(tmp_path / "r.safetensors")
    assert isinstance(loaded.frames, np.memmap)
    for name in ("frames", "time_s", "inputs", "states"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(recording, name))
    for name in ("input_names", "input_units", "segments", "meta"):
        assert getattr(loaded, name) == getattr(recording, name)
    assert isinstance(loaded.part(10, 20).frames, np.memmap)


def test_recording_without_inputs_and_states(recording: Recording, tmp_path: Path) -> None:
    bare = replace(recording, inputs=np.zeros((20, 0)), input_names=(), input_units=(), states=None)
    save_recording(tmp_path / "r.safetensors", bare)
    loaded = load_recording(tmp_path / "r.safetensors")
    assert loaded.inputs.shape == (20, 0)
    assert loaded.states is None


def test_incomplete_artefact_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.safetensors"
    save_artifact(path, {"frames": np.zeros((2, 2, 2, 3), np.uint8)}, {"kind": "recording", "schema": SCHEMA})
    with pytest.raises(ValueError, match=r"without \['inputs', 'time_s'\]"):
        load_recording(path)
    save_artifact(path, {}, {"kind": "chart", "schema": 1})
    with pytest.raises(ValueError, match="holds a 'chart', but a 'recording' is wanted"):
        load_recording(path)


def test_spacing_does_not_count_cuts(recording: Recording) -> None:
    time_s = np.concatenate([0.1 * np.arange(8), 100.0 + 0.1 * np.arange(12)])
    pairs = tuple((i, i + 2) for i in range(0, 20, 2))
    assert replace(recording, time_s=time_s, segments=pairs).dt_s == pytest.approx(0.1)
    with pytest.raises(ValueError, match="no two samples stand in one clip"):
        _ = recording.part(3, 4).dt_s


@pytest.mark.parametrize(
    ("start", "stop", "segments"),
    [
        (0, 20, ((0, 8), (8, 20))),
        (2, 10, ((0, 6), (6, 8))),
        (8, 12, ((0, 4),)),
        (3, 8, ((0, 5),)),
    ],
)
def test_part_shifts_clips(recording: Recording, start: int, stop: int, segments: tuple) -> None:
    part = recording.part(start, stop)
    assert part.segments == segments
    np.testing.assert_array_equal(part.time_s, recording.time_s[start:stop])
    np.testing.assert_array_equal(part.states, recording.states[start:stop])
    assert np.shares_memory(part.frames, recording.frames)


@pytest.mark.parametrize(("start", "stop"), [(-1, 5), (5, 5), (6, 5), (0, 21)])
def test_part_outside_is_refused(recording: Recording, start: int, stop: int) -> None:
    with pytest.raises(ValueError, match=rf"part \[{start}, {stop}\); it must .* the 20 frames"):
        recording.part(start, stop)


def test_split_is_contiguous_and_leaves_nothing(recording: Recording) -> None:
    train, held_out = replace(recording, n_train=13).split()
    assert (train.n_frames, held_out.n_frames) == (13, 7)
    assert train.n_train is None
    np.testing.assert_array_equal(np.concatenate([train.frames, held_out.frames]), recording.frames)


def test_a_recording_that_is_not_divided_has_no_parts(recording: Recording) -> None:
    with pytest.raises(ValueError, match=r"twin\.npz: n_train None; divide"):
        recording.split()


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("frames", np.zeros((20, 3, 4, 5), np.uint8), r"frames of shape \(20, 3, 4, 5\)"),
        ("frames", np.zeros((20, 4, 5, 3), np.float32), "dtype float32; give uint8"),
        ("frames", np.zeros((0, 4, 5, 3), np.uint8), "T >= 1"),
        ("time_s", np.zeros(19), r"time_s of shape \(19,\); give 20"),
        ("time_s", np.full(20, np.nan), "20 finite times"),
        (
            "time_s",
            np.r_[0.1 * np.arange(19), 1.8],
            r"goes from 1\.8 s to 1\.8 s at sample 19 \(1 such",
        ),
        ("time_s", np.r_[0.0, 2.0, 1.0, 3 + np.arange(17.0)], r"2 s to 1 s at sample 2"),
        ("inputs", np.zeros((19, 2)), r"inputs of shape \(19, 2\)"),
        ("inputs", np.zeros(20), r"inputs of shape \(20,\)"),
        ("inputs", np.zeros((20, 3)), "3 columns"),
        ("inputs", np.where(np.arange(40) == 13, np.nan, 0.0).reshape(20, 2), "'p2' is nan at frame 6"),
        ("input_names", ("p1", "p1"), "one name of its own"),
        ("input_units", ("atm",), "one unit"),
        ("states", np.zeros((19, 3)), r"states of shape \(19, 3\)"),
        ("states", np.full((20, 3), np.inf), "states"),
        ("segments", ((0, 8), (9, 20)), "clips must follow one another from 0 to 20"),
        ("segments", ((0, 8), (8, 19)), "clips must"),
        ("segments", ((0, 8), (8, 8), (8, 20)), "clips must"),
        ("meta", {"origin": "dreamt"}, "origin 'dreamt'"),
    ],
)
def test_broken_rules_are_named(recording: Recording, field: str, value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(recording, **{field: value})


def test_numbers_of_other_types_become_float64(recording: Recording, tmp_path: Path) -> None:
    other = replace(recording, inputs=np.ones((20, 2), np.float32), time_s=np.arange(20))
    save_recording(tmp_path / "r.safetensors", other)
    tensors, _ = load_artifact(tmp_path / "r.safetensors")
    assert {tensors[name].dtype for name in ("inputs", "time_s")} == {np.dtype(np.float64)}
