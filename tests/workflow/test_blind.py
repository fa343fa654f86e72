"""The sealed check of the toy profile, from its key to the table."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
SPLIT = Path("results/toy/gap_blind/toy/T0")
TABLE = "results/tables/gap_blind"

pytestmark = [pytest.mark.slow, pytest.mark.campaign]


def snakemake(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile")]
    settings = ["--config", f"hydra=profile=toy blind.keys={folder / 'keys'}"]
    return subprocess.run(
        [*command, "--directory", str(folder), "--cores", "2", f"{TABLE}.tex", *words, *settings],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        cwd=folder,
        check=False,
    )


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the check has run from nothing."""
    folder = tmp_path_factory.mktemp("blind")
    (folder / "keys").mkdir()
    # a key of its own would draw other recordings every time, and other scores
    (folder / "keys" / "toy.key").write_text("a key for tests, which hides nothing\n", encoding="utf-8")
    done = snakemake(folder)
    assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
    return folder


def scores(results: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((results / SPLIT / "score/scores.json").read_text(encoding="utf-8"))
    return found


def test_nothing_of_the_answers_is_in_the_clear(results: Path) -> None:
    assert not list((results / SPLIT).glob("*.jsonl"))
    assert (results / SPLIT / "answers.jsonl.enc").stat().st_size
    key = (results / "keys" / "toy.key").read_text(encoding="utf-8").strip()
    clear = [path for path in results.rglob("*") if path.is_file() and path.suffix != ".key"]
    assert [path for path in clear if key.encode() in path.read_bytes()] == []


def test_every_recording_is_predicted_by_everyone(results: Path) -> None:
    found = scores(results)
    assert found["recordings"] == 9
    assert found["missing"] == 0
    assert set(found["others"]) == {"chance", "discrepancy_test"}
    reasons = [path.read_text(encoding="utf-8") for path in (results / SPLIT).rglob("failed.txt")]
    assert found["others"]["chance"]["missing"] == found["others"]["discrepancy_test"]["missing"] == 0, (
        reasons
    )
    assert found["abstention_left_out"]["n"] == 1
    assert found["submissions"] == 1


def test_the_diagnosis_beats_chance_and_dealt_out_answers(results: Path) -> None:
    found = scores(results)
    assert found["top1_class"]["value"] > found["others"]["chance"]["top1_class"]["high"] - 0.3
    assert found["permuted_top1_class"] < 0.35
    assert found["top1_class"]["value"] > found["permuted_top1_class"]


def test_the_table_has_every_method(results: Path) -> None:
    with (results / f"{TABLE}.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert {"tier", "recordings", "metric", "diagnosis", "chance", "discrepancy_test"} == set(rows[0])
    tex = (results / f"{TABLE}.tex").read_text(encoding="utf-8")
    assert "T0, trajectories: 9 simulated recordings, split toy-T0, opened 1 time" in tex


def test_predictions_name_the_seal_and_the_code(results: Path) -> None:
    for path in (results / SPLIT / "predictions").glob("*/*/made_by.json"):
        made = json.loads(path.read_text(encoding="utf-8"))
        assert len(made["seal"]) == 64
        assert "key" not in made["settings"]


def test_a_second_call_draws_no_other_split(results: Path) -> None:
    done = snakemake(results)
    assert "Nothing to be done" in done.stdout + done.stderr
