"""Minutes of a workflow's jobs."""

from pathlib import Path

import pytest

from benchmarks import speed


def test_minutes_are_medians_over_the_runs_that_are_complete(tmp_path: Path) -> None:
    folder = tmp_path / "quick/benchmarks/simulated"
    for run, seconds in {"default-0": 90.0, "default-1": 900.0, "default-2": 120.0, "default-3": 9.0}.items():
        for name in (name.format(run=run) for names in speed.JOBS.values() for name in names):
            path = folder / "pendulum" / f"{name}.tsv"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"s\tcpu_time\n99.0\t{90.0 if name == 'recording' else seconds}\n")
    (folder / "pendulum/default-3/stage1.tsv").unlink()
    (folder / "rocking_chair").mkdir()
    (found,) = speed.gather_minutes(tmp_path)
    assert found == {
        "system": "pendulum",
        "recording": 1.5,
        "stage 1": 2.0,
        "stage 2": 4.0,
        "scores": 4.0,
        "all": 11.5,
    }
    (folder / "pendulum/recording.tsv").unlink()
    with pytest.raises(FileNotFoundError, match="no system with the records of all jobs"):
        speed.gather_minutes(tmp_path)
