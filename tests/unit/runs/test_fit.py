"""A whole fit in one process, opened again, pushed and scored."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

import lagsplat.runs.run
from lagsplat.config.compose import compose
from lagsplat.pipelines.steps import evaluate, find_lever, hold, push, read_protocol
from lagsplat.runs.fit import fit_run
from lagsplat.runs.run import open_run, rollout

SMALL = (
    "profile=toy",
    "system=toy",
    "system.n_gaussians=128",
    "simulation.n_frames=300",
    "stage1.steps=300",
    "chart.visibility_frames=4",
    *("matter.frames=400", "matter.bending=3", "matter.bodies=3"),  # those of a run that lacks matter
    "evaluate.starts=2",
)


@pytest.mark.slow
def test_a_fit_can_be_opened_pushed_and_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    experiment = compose(*SMALL)
    made = fit_run(experiment, out=tmp_path / "run", header={"config": asdict(experiment)})
    assert not (tmp_path / "run" / "checkpoint" / "state.pt").exists()
    (tmp_path / "run" / "below").mkdir()
    run = open_run(tmp_path / "run" / "below")
    np.testing.assert_array_equal(run.chart.latents, made.chart.latents)
    held = hold(run)
    at, along = find_lever(run)
    assert not held.grasp(at, radius=1.0).is_background
    pushed, _ = push(run, at, along, share=0.3, hold_s=0.5, duration_s=0.5)
    assert np.linalg.norm(pushed[-1] - pushed[0]) > 0.05 * held.visited_radius

    (tmp_path / "run" / "matter.safetensors").unlink()  # as of a run that is older than matter
    before = list_files(tmp_path / "run")
    found = open_run(tmp_path / "run" / "below").matter
    assert torch.equal(found.points, run.matter.points)
    assert list_files(tmp_path / "run") == before
    with monkeypatch.context() as patch:
        patch.setattr(lagsplat.runs.run, "find_matter", None)  # found once
        assert torch.equal(open_run(tmp_path / "run").matter.points, found.points)

    q, v = rollout(run, np.zeros((9, 2)), frame=None)
    assert q.shape == v.shape == (9, 2)
    np.testing.assert_array_equal(q[0], run.chart.rest)
    np.testing.assert_array_equal(v[0], 0)
    assert np.ptp(rollout(run, np.ones((9, 2)), frame=5)[0], axis=0).max() > 0
    with pytest.raises(ValueError, match="trained with 2"):
        rollout(run, np.zeros((9, 1)), frame=None)
    with pytest.raises(ValueError, match="frame=300"):
        rollout(run, np.zeros((9, 2)), frame=300)
    settings = read_protocol(tmp_path / "run", ["evaluate.starts=3"])
    assert settings == replace(experiment.evaluate, starts=3)
    assert evaluate(tmp_path / "run", "evaluate.starts=3")["scores"]["ae_floor"] > 0
    with pytest.raises(ValueError, match="a run keeps its settings"):
        read_protocol(tmp_path / "run", ["stage2.steps=3"])


def list_files(folder: Path) -> dict[Path, int]:
    """Every file below a folder and when it was written."""
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_a_folder_without_a_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no recording\.safetensors"):
        open_run(tmp_path)
