"""Metrics are kept as lines or in a store of MLflow, by what the files of a job say."""

import json
import math
import resource
from pathlib import Path

import pytest

from lagsplat.io.files import tracking
from lagsplat.io.files.tracking import read_curve, read_scores, require_tracking, track

ROWS = [{"step": 12, "loss": 0.5, "psnr": math.nan}, {"step": 24, "loss": 0.25, "stage": "likelihood"}]
SETTINGS = {"cfg": {"rate": {"encoder": 1e-3}}, "seed": 3}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_lines_are_appended_and_whole(here: Path) -> None:
    for rule in ("stage1", "stage2"):
        track("jsonl", ROWS, run="results/toy", rule=rule, settings=SETTINGS)
    lines = [json.loads(line) for line in (here / tracking.LINES).read_text().splitlines()]
    assert [(line["rule"], line["step"]) for line in lines] == [
        (rule, step) for rule in ("stage1", "stage2") for step in (12, 24)
    ]
    assert [line["metrics"] for line in lines[:2]] == [{"loss": 0.5}, {"likelihood.loss": 0.25}]
    assert [line.get("settings") for line in lines] == [SETTINGS, None] * 2
    assert lines[0]["run"] == "results/toy"


def test_nothing_is_kept_unless_asked_for(here: Path) -> None:
    track("none", ROWS, run="a", rule="b", settings={})
    assert list(here.iterdir()) == []


def test_what_a_job_wrote_is_read(here: Path) -> None:
    (here / "curve.csv").write_text("stage,step,loss\nstart,7,nan\nlikelihood,8,0.5\n")
    assert read_curve("curve.csv")[1] == {"stage": "likelihood", "step": 8.0, "loss": 0.5}
    (here / "metrics.json").write_text('{"scores": {"mse_ahead": 0.1, "frequency_error": null}, "other": 1}')
    assert read_scores("metrics.json") == [{"mse_ahead": 0.1, "frequency_error": None}]
    (here / "forces.json").write_text('{"levels": []}')
    assert read_scores("forces.json") == []


def test_what_cannot_be_kept_is_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="tracking=wandb must be one of none, jsonl, mlflow; set it in conf"):
        require_tracking("wandb")
    monkeypatch.setattr(tracking, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match="not installed here; pip install mlflow-skinny"):
        require_tracking("mlflow")


def test_a_store_of_mlflow_holds_metrics_settings_and_names(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mlflow = pytest.importorskip("mlflow", reason="MLflow is not installed")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"file://{here}/store")
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    monkeypatch.delenv("MLFLOW_EXPERIMENT_NAME", raising=False)
    mlflow.set_tracking_uri(f"file://{here}/store")
    track("mlflow", ROWS, run="results/toy", rule="stage1", settings=SETTINGS)
    client = mlflow.MlflowClient()
    experiment = client.get_experiment_by_name(tracking.EXPERIMENT)
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.run_name == "results/toy stage1"
    assert run.data.metrics == {"loss": 0.5, "likelihood.loss": 0.25}
    assert run.data.params == {"cfg.rate.encoder": "0.001", "seed": "3"}
    assert client.get_metric_history(run.info.run_id, "likelihood.loss")[0].step == 24


def test_lines_that_a_full_disk_cuts_short_are_told(here: Path) -> None:
    """A limit on the size of files stands for the disk: the write takes what fits."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50, hard))
    try:
        with pytest.raises(OSError, match="the disk is full; the lines of stage1 are cut short there"):
            track("jsonl", ROWS, run="results/toy", rule="stage1", settings={})
        with pytest.raises(OSError, match="the lines of stage2 are not kept there"):
            track("jsonl", ROWS, run="results/toy", rule="stage2", settings={})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
