"""Many recordings diagnosed in a row: what is kept, what is passed over, and that nothing leaks."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks.gapgen.predictions import read_prediction
from lagsplat.config.compose import compose
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.io.files.atomic import sha256_of
from lagsplat.pipelines.batch import list_batch, predict_recording, read_batch, write_provenance
from tests.unit.benchmarks.cases import move, recording

WATCH = """
import sys
from pathlib import Path
allowed, forbidden, out = (Path(word).resolve() for word in sys.argv[1:])
def watch(event, args):
    if event == "open" and isinstance(args[0], (str, bytes)):
        path = Path(str(args[0])).resolve()
        if path.is_relative_to(forbidden) and not path.is_relative_to(allowed):
            raise PermissionError(f"{path} is none of a diagnosis's business")
sys.addaudithook(watch)
from lagsplat.pipelines.batch import predict_recording
from lagsplat.config.compose import compose
assert predict_recording(allowed, out, compose("profile=toy").diagnose), (out / "failed.txt").read_text()
"""


@pytest.fixture(scope="module")
def config() -> DiagnoseConfig:
    """Settings of the toy profile."""
    return compose("profile=toy").diagnose


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A split of one recording with more damping, its answer beside it."""
    folder = tmp_path_factory.mktemp("split")
    recording(folder / "data" / "b0", move(rate=1.5))
    (folder / "answers.jsonl").write_text('{"id": "b0", "effects": ["viscous_damping"]}')
    return folder


@pytest.fixture(scope="module")
def said(split: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its diagnosis, made by a process that may open nothing else of the split."""
    out = tmp_path_factory.mktemp("said")
    words = [str(split / "data" / "b0"), str(split), str(out)]
    done = subprocess.run(
        [sys.executable, "-c", WATCH, *words],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3])},
    )
    assert done.returncode == 0, done.stderr
    return out


def test_a_diagnosis_opens_its_recording_and_nothing_else_of_the_split(said: Path) -> None:
    found = read_prediction(said, [])
    assert found.ranking[0] == "viscous_damping"
    assert found.gaps is not None
    assert found.gaps[1] < 0.5 * found.gaps[0]


def test_names_times_and_neighbours_change_nothing(
    split: Path, said: Path, config: DiagnoseConfig, tmp_path: Path
) -> None:
    other = tmp_path / "zz"
    shutil.copytree(split / "data" / "b0", other, copy_function=shutil.copyfile)
    (tmp_path / "a neighbour").mkdir()
    for number, path in enumerate(sorted(other.iterdir())):
        os.utime(path, (1e9 + number, 1e9 - number))
    assert predict_recording(other, tmp_path / "out", config)
    first, second = (json.loads((p / "diagnosis.json").read_text()) for p in (said, tmp_path / "out"))
    assert first == second
    assert (said / "rollouts.csv").read_bytes() == (tmp_path / "out" / "rollouts.csv").read_bytes()


def test_what_is_left_out_is_not_named(split: Path, config: DiagnoseConfig, tmp_path: Path) -> None:
    assert predict_recording(split / "data" / "b0", tmp_path, config, without=["viscous_damping"])
    names = [effect["name"] for effect in json.loads((tmp_path / "diagnosis.json").read_text())["effects"]]
    assert "viscous_damping" not in names
    assert "unknown" in names


def test_a_recording_that_cannot_be_diagnosed_says_why(config: DiagnoseConfig, tmp_path: Path) -> None:
    recording(tmp_path / "short", move()[:8])
    assert not predict_recording(tmp_path / "short", tmp_path / "out", config)
    assert "Error" in (tmp_path / "out" / "failed.txt").read_text()
    assert not (tmp_path / "out" / "diagnosis.json").exists()


def test_batches_hold_every_recording_once(tmp_path: Path) -> None:
    for name in ("c", "a", "d", "b", "e"):
        (tmp_path / name).mkdir()
    (tmp_path / "file").touch()
    batches = [[path.name for path in list_batch(tmp_path, k, 2)] for k in range(4)]
    assert batches == [["a", "b"], ["c", "d"], ["e"], []]


def test_runs_are_found_in_any_folder(tmp_path: Path) -> None:
    for folder, name in (("x", "a"), ("y", "b"), ("y", "c")):
        (tmp_path / folder / name).mkdir(parents=True)
    listed = tmp_path / "runs.jsonl"
    listed.write_text("".join(json.dumps({"id": name, "without": [name]}) + "\n" for name in "cab"))
    folders = [tmp_path / "x", tmp_path / "y"]
    found = read_batch(listed, folders, 0, 2)
    assert list(found.items()) == [(tmp_path / "y" / "c", ["c"]), (tmp_path / "x" / "a", ["a"])]
    assert [place.name for place in read_batch(listed, folders, 1, 2)] == ["b"]


def test_predictions_are_signed(tmp_path: Path) -> None:
    (tmp_path / "SEAL.json").write_text("{}")
    write_provenance(tmp_path, tmp_path / "SEAL.json", {"rule": "gap_predict"})
    made: dict[str, Any] = json.loads((tmp_path / "made_by.json").read_text())
    assert made["seal"] == sha256_of(tmp_path / "SEAL.json")
    assert {"tree", "dirty", "time_utc", "rule"} <= set(made)
