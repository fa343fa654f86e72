"""A small run on disk, held against films, logs and tables of latents."""

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lagsplat.chart.chart import save_chart
from lagsplat.diagnose.core.result import Gap, Interval
from lagsplat.diagnose.imaging.rendering import find_nearest_frames
from lagsplat.diagnose.imaging.video_checks import CameraShift
from lagsplat.diagnose.residual.error_budget import PerceptionQuality
from lagsplat.io.recording.recording import save_recording
from lagsplat.io.trajectory.trajectory import Trajectory, leading_samples
from lagsplat.pipelines.diagnosis_videos import (
    ImageQuality,
    RecordedTrajectory,
    RecordingPair,
    open_recording_pair,
)
from lagsplat.stage1.autoencoder import encode_frames, save_autoencoder
from lagsplat.stage2.fit import save_dynamics
from tests.unit.evaluate import tiny_run
from tests.unit.report.diagnosis import made_diagnoses


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A run with one input, 150 frames of training and 150 held out."""
    place = tmp_path_factory.mktemp("run")
    film = tiny_run.recording(300, tail=100)
    model = tiny_run.autoencoder()
    save_recording(place / "recording.safetensors", film)
    save_autoencoder(place / "autoencoder.safetensors", model, {})
    save_chart(place / "chart.safetensors", tiny_run.chart(model, film), {})
    save_dynamics(place / "dynamics.safetensors", tiny_run.lagrangian(), {"report": {}})
    return place


def another(**changes):
    """The same mechanism under the same push, but not the same recording."""
    film = tiny_run.recording(200, tail=100)
    return replace(film, meta={**film.meta, "sha256": "another"}, n_train=None, **changes)


def latents(path, *, d=2, n_u=1, n=60):
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["t", *(f"q{i}" for i in range(d)), *(f"u{i}" for i in range(n_u))])
        for k in range(n):
            rows.writerow([k / 60, *(np.sin(0.2 * k + i) for i in range(d)), *(0.1 for _ in range(n_u))])
    return path


def write_film(path, frames):
    size = frames.shape[2], frames.shape[1]
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 60.0, size)
    for frame in frames:
        film.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    film.release()
    return path


def test_a_run_against_itself_is_its_own_held_out_part(folder):
    recordings = open_recording_pair(folder, "held_out")
    assert recordings.same_recording
    assert recordings.nominal[0].n == recordings.real[0].n == 150
    np.testing.assert_allclose(recordings.real[0].time_s, recordings.run.recording.time_s[150:])
    np.testing.assert_allclose(recordings.real[0].q, recordings.run.chart.latents[150:])
    assert recordings.real[0].u_names == recordings.nominal[0].u_names == ("push",)
    assert recordings.real[0].q_names == recordings.nominal[0].q_names == ("q1", "q2")
    assert recordings.real_recordings[0].recording.n_frames == 150
    again = open_recording_pair(folder, str(folder / "recording.safetensors"))
    assert again.same_recording
    np.testing.assert_array_equal(again.real[0].q, recordings.real[0].q)


def test_of_a_long_held_out_part_the_start_is_taken(folder):
    recordings = open_recording_pair(folder, "held_out", longest_s=1.0)
    assert recordings.real[0].n == 61


def test_another_recording_is_encoded_by_the_run(folder, tmp_path):
    other = another()
    save_recording(tmp_path / "other.safetensors", other)
    recordings = open_recording_pair(folder, str(tmp_path / "other.safetensors"))
    assert not recordings.same_recording
    raw = encode_frames(recordings.run.autoencoder, other.frames)
    np.testing.assert_allclose(recordings.real[0].q, recordings.run.chart.to_whitened(raw))
    np.testing.assert_allclose(recordings.real[0].u, other.inputs)
    assert recordings.real[0].source == "other.safetensors"
    assert recordings.image_quality.perception.ratio > 0.0


def test_a_film_takes_its_inputs_from_the_table_beside_it(folder, tmp_path):
    path = write_film(tmp_path / "swing.avi", another().frames)
    with pytest.raises(ValueError, match="CSV of the same stem"):
        open_recording_pair(folder, str(path))
    with path.with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([["t", "u0"], *([k / 10, 0.5 * k] for k in range(40))])
    recordings = open_recording_pair(folder, str(path))
    assert (recordings.real[0].d, recordings.real[0].n_u) == (2, 1)
    np.testing.assert_allclose(recordings.real[0].u[:, 0], 5.0 * recordings.real[0].time_s, atol=1e-6)


def test_latents_are_taken_as_they_are(folder, tmp_path):
    recordings = open_recording_pair(folder, str(latents(tmp_path / "q.csv")))
    assert recordings.real_recordings[0].recording is None
    assert recordings.image_quality is None
    assert (recordings.real[0].q_names, recordings.real[0].u_names) == (("q1", "q2"), ("push",))
    assert recordings.camera_share == 0.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda place: latents(place / "q.csv", d=3), "3 coordinate"),
        (lambda place: latents(place / "q.csv", n_u=0), "0 input"),
        (lambda place: place / "gone.mp4", "no such file"),
    ],
)
def test_what_does_not_fit_the_run_is_refused(folder, tmp_path, make, words):
    with pytest.raises((ValueError, FileNotFoundError), match=words):
        open_recording_pair(folder, str(make(tmp_path)))


def test_pictures_of_another_size_are_refused(folder, tmp_path):
    save_recording(
        tmp_path / "large.safetensors",
        replace(another(), frames=tiny_run.recording(200, tail=100, side=20).frames),
    )
    with pytest.raises(ValueError, match="20 x 20 px"):
        open_recording_pair(folder, str(tmp_path / "large.safetensors"))


def test_the_own_recording_and_others_are_not_mixed(folder, tmp_path):
    q = latents(tmp_path / "q.csv")
    with pytest.raises(ValueError, match="one kind at a time"):
        open_recording_pair(folder, f"[{folder / 'recording.safetensors'},{q}]")


def test_frames_are_found_by_their_times():
    film = tiny_run.recording(100, tail=30)
    np.testing.assert_array_equal(find_nearest_frames(film, film.time_s[[0, 7, 99]] + 0.004), [0, 7, 99])


def test_leading_clips_last_as_long_as_asked():
    motion = Trajectory(
        np.arange(100) / 10, np.zeros((100, 1)), np.zeros((100, 0)), segments=((0, 40), (40, 100))
    )
    assert leading_samples(motion, 100.0).segments == motion.segments
    assert leading_samples(motion, 2.0).segments == ((0, 21),)
    assert leading_samples(motion, 5.0).segments == ((0, 40), (40, 52))


class Judged(RecordingPair):
    """Films whose pictures need not be drawn."""

    seen = ImageQuality(np.ones(1), np.ones(1), PerceptionQuality(1.0, 0.0, False))

    @property
    def image_quality(self):
        return self.seen


def judged(folder, *, share, perception=None):
    made = open_recording_pair(folder, "held_out")
    camera = replace(made.real_recordings[0].camera, share=share)
    side = RecordedTrajectory(made.real_recordings[0].motion, made.real_recordings[0].recording, camera)
    recordings = Judged(made.run, made.nominal, (side,), True)
    if perception is not None:
        object.__setattr__(recordings, "seen", ImageQuality(np.ones(1), np.ones(1), perception))
    return recordings


def test_a_moved_camera_forbids_a_name_that_it_passes_for(folder):
    gap = Gap(0.1, 0.1, 0.02, 0.01, 1.0, Interval(0.9, 0.8, 1.0))
    friction = replace(made_diagnoses.friction(), gap=gap)
    assert "undetermined" not in judged(folder, share=0.04).judge(friction).checks
    found = judged(folder, share=0.06).judge(friction)
    assert "camera moved" in found.checks["undetermined"][0]
    named = replace(friction, combination=("camera_change",))
    assert "undetermined" not in judged(folder, share=0.06).judge(named).checks


def test_strange_pictures_make_a_verdict_conditional(folder):
    fine = judged(folder, share=0.0).judge(made_diagnoses.friction())
    assert fine.checks["conditional_on_perception"] is False
    strange = PerceptionQuality(3.0, 0.2, True)
    found = judged(folder, share=0.0, perception=strange).judge(made_diagnoses.friction())
    assert found.checks["conditional_on_perception"] is True
    assert any("conditional on perception" in text for text in found.warnings)
    assert "undetermined" not in found.checks


def test_pictures_that_the_encoder_cannot_read_name_nothing_but_a_camera(folder):
    unread = judged(folder, share=0.0, perception=PerceptionQuality(10.0, 0.0, True))
    found = unread.judge(made_diagnoses.friction())
    assert "10 times as badly" in found.checks["undetermined"][0]
    blurred = replace(made_diagnoses.friction(), combination=("exposure_blur",))
    assert "undetermined" not in unread.judge(blurred).checks


@pytest.mark.parametrize(
    ("within", "between", "own", "names"),
    [
        (0.01, (0.0, 0.1), False, {"camera_drift", "camera_change"}),
        (0.01, None, False, {"camera_drift"}),
        (0.01, None, True, {"camera_drift", "camera_change"}),
        (None, (0.0, 0.1), False, {"camera_change"}),
        (0.5, (2.0, 0.0), False, set()),
        (None, None, True, set()),
    ],
)
def test_a_background_that_stood_still_rules_cameras_out(folder, within, between, own, names):
    made = open_recording_pair(folder, "held_out")
    side = replace(made.real_recordings[0], camera=CameraShift(within, between, 0.0))
    assert set(replace(made, real_recordings=(side,), same_recording=own).ruled_out) == names
    bare = replace(made, real_recordings=(side, RecordedTrajectory(made.real_recordings[0].motion)))
    assert bare.ruled_out == ()
