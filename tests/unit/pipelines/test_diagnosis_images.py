"""Pictures of a small run that was diagnosed: their numbers and shapes, not their quality."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lagsplat.diagnose.core.result import Block
from lagsplat.diagnose.diagnosis import DiagnosisRun
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.residual.localization import locate
from lagsplat.diagnose.simulators.fitted_run import project_run, read_chart_trajectory
from lagsplat.pipelines.diagnosis import compute_error_stages
from lagsplat.pipelines.diagnosis_images import add_images
from lagsplat.pipelines.diagnosis_videos import RecordedTrajectory, RecordingPair
from lagsplat.report.diagnosis.content import ReportContent
from lagsplat.runs.run import FittedRun
from tests.unit.evaluate import tiny_run
from tests.unit.report.diagnosis import made_diagnoses

PERIOD_S = 0.5


@pytest.fixture(scope="module")
def recordings():
    film = tiny_run.recording(400, tail=100)
    model = tiny_run.autoencoder()
    run = FittedRun(film, model, tiny_run.chart(model, film), tiny_run.lagrangian())
    real, nominal = (read_chart_trajectory(run.chart, held_out=held) for held in (True, False))
    return RecordingPair(run, (nominal,), (RecordedTrajectory(real, film.split()[1]),), same_recording=True)


@pytest.fixture(scope="module")
def mechanics(recordings):
    motion = recordings.nominal[0]
    v = np.gradient(motion.q, motion.time_s, axis=0)
    return project_run(recordings.run.lagrangian, OperatingRegion(motion.q, v, motion.u), what="run").model


def diagnosed(recordings, mechanics):
    """A pair and a finding, of which only what the pictures need is there."""
    real = recordings.real[0]
    blocks = tuple(
        Block(
            real.source,
            i,
            real.time_s[a : a + 31],
            real.q[a : a + 31],
            real.q[a : a + 31] + 0.4,
            real.q[a : a + 31] + 0.05,
        )
        for i, a in enumerate((20, 50, 110))
    )
    where = locate(mechanics, recordings.real, period_s=PERIOD_S)
    made = replace(
        made_diagnoses.friction(), blocks=blocks, where=where, checks={"natural_period_s": PERIOD_S}
    )
    pair = SimpleNamespace(
        recordings=recordings,
        sim=SimpleNamespace(model=mechanics),
        real=recordings.real,
        checked=SimpleNamespace(sim=SimpleNamespace(motions=recordings.nominal)),
    )
    problem = SimpleNamespace(rollout_model=SimpleNamespace(held=False))
    return pair, SimpleNamespace(diagnosis=made, problem=problem, search=SimpleNamespace(problem=problem))


@pytest.fixture(scope="module")
def image_content(recordings, mechanics):
    pair, found = diagnosed(recordings, mechanics)
    return add_images(pair, DiagnosisRun(found.diagnosis, found.search, None, None, None), ReportContent())


def test_the_error_budget_has_every_stage_with_its_floor(recordings, mechanics):
    stages = {stage.name: stage for stage in compute_error_stages(*diagnosed(recordings, mechanics))}
    assert list(stages) == ["perception", "chart", "one step", "rollout"]
    assert all(stage.floor > 0.0 and stage.low <= stage.value <= stage.high for stage in stages.values())


def test_image_errors_are_in_the_checks(image_content):
    image = image_content[0].diagnosis.checks["image"]
    assert image["floor"] > 0.0
    assert image["after"] < image["before"]
    assert image["closure"] is None or image["closure"] > 0.5
    assert set(image["stages"]) == {"perception", "chart", "one step", "rollout"}
    assert min(image["stages"].values()) >= 0.0
    assert sum(image["stages"].values()) == pytest.approx(
        1.0, abs=0.2
    )  # more, where a stage mends the last one


def test_the_error_map_covers_the_frame(image_content):
    _, content = image_content
    assert content.image_error.excess.shape == content.image_error.frame.shape[:2] == (16, 16)
    assert content.image_error.excess.max() > 0.0
    assert content.image_error.frame.dtype == np.uint8
    region = image_content[0].diagnosis.where.image_region
    assert region["localisable"] in (True, False)


def test_the_video_has_consecutive_blocks(image_content, recordings):
    video = image_content[1].video
    assert video.real.shape == video.sim.shape == video.augmented.shape == (93, 16, 16, 3)
    np.testing.assert_array_equal(video.real[0], recordings.real_recordings[0].recording.frames[20])
    assert video.slowed == pytest.approx(1.0 / PERIOD_S)
    assert video.frames_per_s == pytest.approx(60.0 * PERIOD_S)


def test_latents_without_images_have_no_perception_stage(recordings, mechanics):
    bare = RecordingPair(
        recordings.run, recordings.nominal, (RecordedTrajectory(recordings.real[0]),), same_recording=False
    )
    pair, found = diagnosed(bare, mechanics)
    assert [stage.name for stage in compute_error_stages(pair, found)] == ["chart", "one step", "rollout"]
    run = DiagnosisRun(found.diagnosis, found.search, None, None, None)
    found, content = add_images(pair, run, ReportContent())
    assert content.video is None
    assert "image" not in found.diagnosis.checks


def test_where_the_gap_is_not_located_the_frames_are_compared_all_the_same(recordings, mechanics):
    pair, found = diagnosed(recordings, mechanics)
    lost = replace(found.diagnosis, where=None)
    run, content = add_images(pair, DiagnosisRun(lost, found.search, None, None, None), ReportContent())
    assert run.diagnosis.where is None
    assert content.image_force is None
    assert content.image_error.excess.max() > 0.0
    assert "stages" not in run.diagnosis.checks["image"]
