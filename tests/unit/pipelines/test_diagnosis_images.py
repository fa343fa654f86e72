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
from lagsplat.pipelines.diagnosis import compute_error_stages as ladder
from lagsplat.pipelines.diagnosis_images import build_image_content
from lagsplat.pipelines.diagnosis_videos import RecordedTrajectory, RecordingPair
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
    return pair, SimpleNamespace(diagnosis=made, problem=problem)


@pytest.fixture(scope="module")
def shown(recordings, mechanics):
    pair, found = diagnosed(recordings, mechanics)
    return build_image_content(pair, DiagnosisRun(found.diagnosis, found.problem, None, None))


def test_the_ladder_has_every_rung_with_its_floor(recordings, mechanics):
    rungs = {rung.name: rung for rung in ladder(*diagnosed(recordings, mechanics))}
    assert list(rungs) == ["perception", "chart", "one step", "rollout"]
    assert all(rung.floor > 0.0 and rung.low <= rung.value <= rung.high for rung in rungs.values())


def test_errors_of_pictures_stand_beside_those_of_latents(shown):
    image = shown[0].diagnosis.checks["image"]
    assert image["floor"] > 0.0
    assert image["after"] < image["before"]
    assert image["closure"] is None or image["closure"] > 0.5
    assert set(image["stages"]) == {"perception", "chart", "one step", "rollout"}


def test_the_picture_shows_where_the_sim_draws_wrongly(shown):
    _, exhibits = shown
    assert exhibits.picture.excess.shape == exhibits.picture.picture.shape[:2] == (16, 16)
    assert exhibits.picture.excess.max() > 0.0
    assert exhibits.picture.picture.dtype == np.uint8
    region = shown[0].diagnosis.where.image_region
    assert region["localisable"] in (True, False)


def test_the_film_shows_the_blocks_side_by_side(shown, recordings):
    film = shown[1].film
    assert film.real.shape == film.sim.shape == film.augmented.shape == (93, 16, 16, 3)
    np.testing.assert_array_equal(film.real[0], recordings.real_recordings[0].recording.frames[20])
    assert film.slowed == pytest.approx(1.0 / PERIOD_S)
    assert film.frames_per_s == pytest.approx(60.0 * PERIOD_S)


def test_latents_without_pictures_have_a_ladder_without_them(recordings, mechanics):
    bare = RecordingPair(
        recordings.run, recordings.nominal, (RecordedTrajectory(recordings.real[0]),), same_recording=False
    )
    pair, found = diagnosed(bare, mechanics)
    assert [rung.name for rung in ladder(pair, found)] == ["chart", "one step", "rollout"]
    found, exhibits = build_image_content(pair, DiagnosisRun(found.diagnosis, found.problem, None, None))
    assert exhibits.film is None
    assert "image" not in found.diagnosis.checks
