"""A film as the sim: its run is fitted once, kept, continued, and refused before the fit where it must be."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lagsplat.cli.main import main
from lagsplat.config.compose import ConfigError, compose
from lagsplat.config.schema import Config
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.io.files.lease import hold_lease
from lagsplat.io.recording.recording import Recording, save_recording
from lagsplat.io.sources import find_sources
from lagsplat.pipelines import diagnosis_videos, film_runs
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs
from lagsplat.pipelines.diagnosis_videos import open_recording_pair
from lagsplat.stage1 import fit as stage1_fit
from tests.films import RATE, swing, write_film
from tests.unit.io.robot_log.mcap_files import Take, by_this_package

TOY = replace(compose().diagnose, film_profile="toy")
SHAPE = (24, 32)
Fits = list[tuple[Config, Recording]]


def make_film(path: Path, **changes: Any) -> Path:
    return write_film(path, swing(**({"shape": SHAPE} | changes))[0], codec="FFV1")


def write_inputs(film: Path, *, seconds: float = 6.0) -> Path:
    table = film.with_suffix(".csv")
    table.write_text(f"t,u0\n0,1\n{seconds},3\n")
    return table


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``sim.mkv`` and ``real.mkv``."""
    folder = tmp_path_factory.mktemp("films")
    make_film(folder / "sim.mkv")
    make_film(folder / "real.mkv", amplitude=0.4, period_s=1.2)
    return folder


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, below the test's own folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "lagsplat" / "runs"


@pytest.fixture
def fits(monkeypatch: pytest.MonkeyPatch) -> Fits:
    """The fits that were asked for, none of which trains anything."""
    made: Fits = []

    def pretend(experiment: Config, *, out: Path, recording: Recording) -> None:
        made.append((experiment, recording))
        save_recording(out / "recording.safetensors", recording)
        (out / "dynamics.safetensors").touch()

    monkeypatch.setattr(film_runs, "fit_run", pretend)
    return made


def fit(sim: object, real: object, config: DiagnoseConfig = TOY, **others: Any) -> Path:
    return film_runs.fit_film(find_sources(str(sim)), str(real), config, **others)[0]


def test_a_film_is_fitted_once(films: Path, cache: Path, fits: Fits, tmp_path: Path) -> None:
    said: list[str] = []
    folder = fit(films / "sim.mkv", films / "real.mkv", show_fit=said.append)
    assert folder.parent == cache
    assert "fitted to sim.mkv at profile toy" in said[0]
    assert str(folder) in said[0]
    assert "taken to have 1 coordinate; diagnose.film_d=2 for two" in said[0]
    moved = tmp_path / "moved.mkv"
    moved.write_bytes((films / "sim.mkv").read_bytes())
    assert fit(moved, films / "real.mkv", show_fit=said.append) == folder
    assert said[1].endswith("it is used again")
    assert len(fits) == 1


def test_another_number_of_coordinates_film_or_table_is_another_run(
    films: Path, fits: Fits, tmp_path: Path
) -> None:
    sim = tmp_path / "sim.mkv"
    sim.write_bytes((films / "sim.mkv").read_bytes())
    folders = [fit(sim, "held_out"), fit(sim, "held_out", replace(TOY, film_d=2))]
    write_inputs(sim)
    folders += [fit(sim, "held_out"), fit(films / "real.mkv", "held_out")]
    assert len({*folders}) == len(fits) == 4
    assert [experiment.stage1.d for experiment, _ in fits] == [1, 2, 1, 1]
    assert [recording.input_names for _, recording in fits] == [(), (), ("u0",), ()]


def test_the_film_chooses_its_settings(fits: Fits, tmp_path: Path) -> None:
    make_film(tmp_path / "sim.mkv", shape=(120, 160), hand_until_s=1.0)
    _, findings = film_runs.fit_film(find_sources(str(tmp_path / "sim.mkv")), "held_out", TOY)
    experiment, recording = fits[0]
    assert f"from {experiment.recording.skip_s:g} s to its end" in findings[1].what
    assert (recording.height, recording.width) == (72, 96)
    assert recording.time_s[0] == pytest.approx(experiment.recording.skip_s, abs=1.0 / RATE)
    assert experiment.recording.skip_s >= 1.0
    assert experiment.chart.smoothing_frames == pytest.approx(1.7, abs=0.1)
    assert experiment.stage1.steps == compose("profile=toy").stage1.steps
    assert experiment.simulation is None


def test_a_folder_of_images_is_a_film(fits: Fits, tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    frames, time_s = swing(shape=SHAPE)
    for number, frame in enumerate(frames):
        cv2.imwrite(str(images / f"{number}.png"), frame)
    (images / "times.csv").write_text("\n".join(["t", *map(str, time_s)]))
    fit(images, "held_out")
    recording = fits[0][1]
    np.testing.assert_allclose(recording.time_s, time_s[: recording.n_frames])
    assert recording.n_frames >= len(time_s) - 1  # the last one may count as a repetition


def test_an_archive_of_an_arm_is_a_film(fits: Fits, tmp_path: Path) -> None:
    frames, time_s = swing(shape=SHAPE)
    images = frames.transpose(0, 3, 1, 2)
    np.savez(tmp_path / "arm.npz", images=images, p1=np.sin(time_s), p2=np.cos(time_s))
    fit(tmp_path / "arm.npz", "held_out")
    assert fits[0][1].inputs.shape == (len(frames), 2)
    save_recording(tmp_path / "arm.safetensors", fits[0][1])
    fit(tmp_path / "arm.safetensors", "held_out")
    assert fits[1][1].n_frames == len(frames)


def test_the_camera_of_a_log_is_a_film(fits: Fits, tmp_path: Path) -> None:
    frames, time_s = swing(shape=SHAPE)
    stamps = (1e9 * time_s).astype(np.int64)
    angles = np.stack([np.sin(time_s), np.cos(time_s)], axis=1)
    by_this_package(tmp_path / "log.mcap", Take(frames, stamps, angles, stamps))
    fit(tmp_path / "log.mcap", "held_out")
    write_inputs(tmp_path / "log.mcap")
    fit(tmp_path / "log.mcap", "held_out")
    assert [recording.input_names for _, recording in fits] == [(), ("u0",)]
    assert fits[0][0].recording.mcap.camera == "/camera"


def still(folder: Path) -> tuple[object, object]:
    return make_film(folder / "still.mkv", amplitude=0.0), "held_out"


def short(folder: Path) -> tuple[object, object]:
    return make_film(folder / "short.mkv", seconds=0.8), "held_out"


def damaged(folder: Path) -> tuple[object, object]:
    (folder / "damaged.mkv").write_bytes(b"no film")
    return folder / "damaged.mkv", "held_out"


def damaged_real(folder: Path) -> tuple[object, object]:
    return make_film(folder / "sim.mkv"), damaged(folder)[0]


def several(folder: Path) -> tuple[object, object]:
    return f"[{make_film(folder / 'a.mkv')},{make_film(folder / 'b.mkv')}]", "held_out"


def other_shape(folder: Path) -> tuple[object, object]:
    return make_film(folder / "sim.mkv"), make_film(folder / "square.mkv", shape=(24, 24))


def without_inputs(folder: Path) -> tuple[object, object]:
    write_inputs(make_film(folder / "sim.mkv"))
    return folder / "sim.mkv", make_film(folder / "real.mkv", amplitude=0.3)


def table(folder: Path) -> tuple[object, object]:
    (folder / "angle.csv").write_text("t,q0\n0,1\n0.1,2\n0.2,4\n")
    return make_film(folder / "sim.mkv"), folder / "angle.csv"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (still, "nothing moves"),
        (short, "of which 16 are for"),
        (damaged, "OpenCV cannot open it"),
        (damaged_real, "OpenCV cannot open it"),
        (several, "names 2 files.*name one film"),
        (other_shape, "a film of 24 x 24 px .* but the sim's has 32 x 24"),
        (without_inputs, "0 input.*fitted with 1; give the inputs in a CSV"),
        (table, "a trajectory cannot be compared with a film"),
    ],
)
def test_what_cannot_be_diagnosed_is_refused_before_the_fit(
    make: Callable[[Path], tuple[object, object]], words: str, fits: Fits, cache: Path, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=words):
        fit(*make(tmp_path))
    assert fits == []
    assert not cache.exists()


def test_settings_are_checked(films: Path) -> None:
    with pytest.raises(ValueError, match="film_d=0 must be at least 1"):
        replace(TOY, film_d=0)
    with pytest.raises(ConfigError, match="base full quick toy"):
        fit(films / "sim.mkv", "held_out", replace(TOY, film_profile="slow"))


def test_the_command_line_says_why(films: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["diagnose", f"sim={films}", f"real={films / 'real.mkv'}", f"out={tmp_path / 'out'}"]
    assert main(words) == 2
    assert "name one film" in capsys.readouterr().err
    assert not (tmp_path / "out" / "diagnosis.json").exists()


def test_processes_that_want_the_same_run_wait_for_one_another(films: Path, fits: Fits) -> None:
    folder = fit(films / "sim.mkv", "held_out")
    (folder / "dynamics.safetensors").unlink()
    waits = threading.Event()

    def show(text: str) -> None:
        if "waiting for it" in text:
            waits.set()

    with hold_lease(folder):
        other = threading.Thread(target=fit, args=(films / "sim.mkv", "held_out"), kwargs={"show_fit": show})
        other.start()
        assert waits.wait(60.0)
        (folder / "dynamics.safetensors").touch()
    other.join(60.0)
    assert not other.is_alive()
    assert len(fits) == 1


def test_the_run_is_the_sim_from_then_on(films: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(folder: Path, real: str, **_: object) -> None:
        raise ValueError(f"{folder} and {real}")

    monkeypatch.setattr(film_runs, "fit_film", lambda *_, **__: (Path("run"), ()))
    monkeypatch.setattr(diagnosis_videos, "open_recording_pair", opened)
    with pytest.raises(ValueError, match="run and held_out"):
        open_diagnosis_inputs(str(films / "sim.mkv"), "held_out", TOY)


@pytest.mark.slow
def test_a_fit_that_was_stopped_goes_on(films: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = (
        "system.n_gaussians=256",
        "system.encoder_rate=2e-3",
        "stage1.checkpoint_every_s=1e-6",
        "stage1.steps=600",
    )
    small += ("stage2.likelihood.frames=600", "stage2.likelihood.iterations=8")
    small += ("stage2.form.potential_degree=4",)
    monkeypatch.setattr(film_runs, "compose", lambda *words: compose(*words, *small))
    steps: list[int] = []
    stop_at, take = 400, stage1_fit.train_step

    def train(*given: Any) -> np.ndarray:
        if len(steps) == stop_at:
            raise KeyboardInterrupt
        steps.append(given[4])
        return take(*given)

    monkeypatch.setattr(stage1_fit, "train_step", train)
    with pytest.raises(KeyboardInterrupt):
        fit(films / "sim.mkv", films / "real.mkv")
    stop_at = -1
    folder = fit(films / "sim.mkv", films / "real.mkv")
    assert steps == list(range(600))
    recordings = open_recording_pair(folder, str(films / "real.mkv"))
    assert recordings.run.chart.d == 1
    assert not recordings.same_recording
    # the latent of another motion of the same ball swings as that ball does
    q = recordings.real[0].q[:, 0]
    assert q.std() > 0.2
    assert fit(films / "sim.mkv", films / "real.mkv") == folder
    assert len(steps) == 600
