"""Minutes of a workflow's jobs."""

from pathlib import Path

import pytest

from benchmarks import speed


def test_minutes_are_those_of_the_jobs_of_systems_that_are_complete(tmp_path: Path) -> None:
    folder = tmp_path / "quick/benchmarks/simulated"
    for names in speed.JOBS.values():
        for name in names:
            path = folder / "pendulum" / f"{name}.tsv"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("s\tcpu_time\n99.0\t90.0\n")
    (folder / "rocking_chair").mkdir()
    (found,) = speed.gather_minutes(tmp_path)
    assert found == {
        "system": "pendulum",
        "recording": 1.5,
        "stage 1": 1.5,
        "stage 2": 3.0,
        "scores": 3.0,
        "all": 9.0,
    }
    (folder / "pendulum/recording.tsv").unlink()
    with pytest.raises(FileNotFoundError, match="no system with the records of all jobs"):
        speed.gather_minutes(tmp_path)
