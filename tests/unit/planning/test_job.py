"""The frame of a workflow job: log, record, failure."""

import json
import logging
import warnings
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import pytest
from snakemake.iocontainers import InputFiles, OutputFiles, Params, Wildcards

from lagsplat.config.compose import compose
from lagsplat.io.config import RecordingConfig, SplitConfig
from lagsplat.io.files.lease import hold_lease, locate_lease
from lagsplat.io.files.tracking import LINES
from lagsplat.planning.job import Job


@pytest.fixture(autouse=True)
def quiet_logging() -> Iterator[None]:
    """The job takes over the root logger of its process; give it back afterwards."""
    root = logging.getLogger()
    level, handlers, shown = root.level, root.handlers[:], warnings.showwarning
    yield
    logging.captureWarnings(False)
    warnings.showwarning = shown
    for handler in root.handlers:
        if handler not in handlers:
            handler.close()
    root.handlers[:] = handlers
    root.setLevel(level)


def context(folder: Path, **params: object) -> SimpleNamespace:
    (folder / "in.txt").write_text("frames", encoding="utf-8")
    (folder / "made.json").write_text("{}", encoding="utf-8")
    return SimpleNamespace(
        rule="stage1",
        input=InputFiles(
            fromdict={"recording": str(folder / "in.txt"), "records": str(folder / "made.json")}
        ),
        output=OutputFiles(fromdict={"record": str(folder / "out.json")}),
        params=Params(fromdict={"cfg": {"steps": 3}, "title": "toy arm", **params}),
        wildcards=Wildcards(fromdict={"profile": "toy", "recording": "simulated", "ae": "7"}),
        threads=1,
        log=[str(folder / "job.log")],
    )


def test_a_finished_job_leaves_a_record_and_a_log(tmp_path: Path) -> None:
    with Job(context(tmp_path)) as job:
        assert job.seed == 7
        assert job.title("Frames") == "Frames · toy arm · simulated recording · profile toy"
        job.say("half way")
    record = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert record["rule"] == "stage1"
    assert record["settings"]["cfg"] == {"steps": 3}
    assert record["stamp"]["python"]
    assert record["wall_s"] >= 0
    assert "half way" in (tmp_path / "job.log").read_text(encoding="utf-8")


def test_a_failed_job_says_why_in_one_line_and_leaves_no_record(tmp_path: Path) -> None:
    with (
        pytest.raises(SystemExit, match=r"^stage1: no frames \(traceback: .*job\.log\)$"),
        Job(context(tmp_path)),
    ):
        raise ValueError("no frames")
    assert not (tmp_path / "out.json").exists()
    assert "Traceback" in (tmp_path / "job.log").read_text(encoding="utf-8")


def test_a_job_that_another_process_runs_is_refused_before_it_touches_anything(tmp_path: Path) -> None:
    given = context(tmp_path)
    (tmp_path / "job.log").write_text("of the other job")
    with (
        hold_lease(tmp_path / "out.json"),
        pytest.raises(SystemExit, match=r"^stage1: \S+out\.json: process \d+ on \S+ is making it"),
        Job(given),
    ):
        pytest.fail("two writers")
    assert (tmp_path / "job.log").read_text() == "of the other job"
    with Job(given):
        assert locate_lease(tmp_path / "out.json").is_file()
    assert not list(tmp_path.glob(".*.lease"))


def test_a_stopped_job_is_not_a_failed_one(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), Job(context(tmp_path)):
        raise KeyboardInterrupt
    assert not (tmp_path / "out.json").exists()


def test_the_identity_follows_settings_and_inputs_but_not_records(tmp_path: Path) -> None:
    identity = Job(context(tmp_path)).identity
    assert Job(context(tmp_path)).identity == identity
    assert Job(context(tmp_path, code="changed")).identity != identity
    given = context(tmp_path)
    (tmp_path / "made.json").write_text('{"wall_s": 3}', encoding="utf-8")
    assert Job(given).identity == identity
    (tmp_path / "in.txt").write_text("other frames", encoding="utf-8")
    assert Job(given).identity != identity


def test_a_section_is_typed_again(tmp_path: Path) -> None:
    values = asdict(compose("system=pendulum_pair", "recording.path=film.mp4").recording)
    job = Job(context(tmp_path, cfg=values, other=None))
    section = job.section(RecordingConfig)
    assert isinstance(section.split, SplitConfig)
    assert asdict(section) == values
    assert job.choice(RecordingConfig, "other") is None


@pytest.mark.parametrize(("asked", "kept"), [("tracking=jsonl", ["0.5", "0.25"]), ("profile=toy", [])])
def test_a_job_tracks_its_curve_where_the_experiment_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: str, kept: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    given = context(tmp_path)
    given.config = {"hydra": asked}
    given.output = OutputFiles(fromdict={"curve": str(tmp_path / "curve.csv")})
    with Job(given):
        (tmp_path / "curve.csv").write_text("step,loss\n12,0.5\n24,0.25\n")
    lines = tmp_path / LINES
    found = [json.loads(line) for line in lines.read_text().splitlines()] if lines.exists() else []
    assert [str(line["metrics"]["loss"]) for line in found] == kept
    assert all((line["run"], line["rule"]) == (str(tmp_path), "stage1") for line in found)


def test_a_store_that_fails_costs_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").write_text("a file where the folder should be")
    given = context(tmp_path)
    given.config = {"hydra": "tracking=jsonl"}
    given.output = OutputFiles(fromdict={"curve": str(tmp_path / "curve.csv")})
    with Job(given):
        (tmp_path / "curve.csv").write_text("step,loss\n12,0.5\n")
    assert "tracking=jsonl: the metrics were not kept: " in capsys.readouterr().err
