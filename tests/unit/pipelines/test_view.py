"""From folders to sessions and pages: titles, pages of a kept run, the residual of a diagnosis."""

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagsplat.cli.main import main
from lagsplat.config.compose import compose
from lagsplat.diagnose.augmented.model import save_augmented
from lagsplat.io.files.artifact import save_artifact
from lagsplat.pipelines import view as viewing
from lagsplat.runs.run import open_run
from tests.oracle.test_augmented import sim
from tests.unit.evaluate import tiny_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("results") / "quick/simulated/krauss_2seg/default-0/default-0"
    tiny_run.save_run(out)
    return out


def recorded_settings(kind: str, path: str | None, title: str = "hanging bag") -> dict[str, Any]:
    return {"config": {"system": {"title": title}, "recording": {"kind": kind, "path": path}}}


def test_a_run_is_called_by_its_system(folder: Path, tmp_path: Path) -> None:
    assert viewing.title_of(folder) == "Krauss arm, two segments (simulated)"
    assert viewing.title_of(tmp_path / "mine") == "mine"


@pytest.mark.parametrize(
    ("header", "title"),
    [
        ({"wildcards": {"system": "toy", "recording": "simulated"}}, "Toy arm (simulated)"),
        (recorded_settings("simulated", None), "Hanging bag (simulated)"),
        (recorded_settings("krauss", None), "Hanging bag (filmed)"),
        (recorded_settings("video", "bag.mp4"), "Hanging bag (filmed)"),
        (recorded_settings("video", "bag.mp4", "film"), "elsewhere"),
        (recorded_settings("video", "bag.mp4", "Krauss arm, two segments"), "elsewhere"),
    ],
)
def test_a_run_elsewhere_is_called_by_the_system_that_it_records(
    tmp_path: Path, header: dict, title: str
) -> None:
    away = tmp_path / "elsewhere"
    away.mkdir()
    save_artifact(away / "dynamics.safetensors", {}, {"kind": "dynamics", "schema": 1, **header})
    assert viewing.title_of(away) == title


def test_a_page_is_written_of_a_kept_run(folder: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "arm.html"
    assert main(["export", str(folder), "--html", f"out={out}"]) == 0
    assert capsys.readouterr().out.strip() == str(out)
    assert "Krauss arm, two segments (simulated)" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(("number", "told"), [(signal.SIGTERM, "SIGTERM"), (signal.SIGINT, "Ctrl-C")])
def test_the_live_view_ends_cleanly_and_says_why(folder: Path, number: int, told: str) -> None:
    # a process in the background, as the tests may be, ignores SIGINT, and so do those that it starts
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from lagsplat.cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", program, "view", str(folder), "--no-browser", "viewer.port=0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert "Krauss arm, two segments (simulated): http://127.0.0.1:" in process.stdout.readline()
            process.send_signal(number)
            out, error = process.communicate(timeout=60.0)
        finally:
            process.kill()
    assert process.returncode == 0, error
    assert f"ended by {told}; saved sessions are in {folder}" in out
    assert "Traceback" not in error


def test_the_residual_of_a_diagnosis_follows_the_session(folder: Path, tmp_path: Path) -> None:
    damped = sim(("viscous_damping", [0.7]))
    save_augmented(tmp_path / "augmented.safetensors", damped, {})
    run = open_run(folder)
    session = viewing.pushable(run, compose())
    residual = viewing._residual(tmp_path, session, run.lagrangian)
    session.v = np.array([2.0])
    assert residual(session.snapshot())[0] == pytest.approx(-2.0 * damped.parameters(0)["rate"], rel=0.05)


def test_a_diagnosis_of_another_sim_and_a_damaged_session_are_told(
    folder: Path, tmp_path: Path, capsys
) -> None:
    (tmp_path / "old.mcap").write_bytes(b"nothing")
    assert main(["view", str(folder), "--no-browser", f"replay={tmp_path / 'old.mcap'}"]) == 2
    assert "not a whole MCAP file" in capsys.readouterr().err
    assert main(["view", str(folder), "--no-browser", f"diagnosis={tmp_path / 'none'}"]) == 2
    assert "no such file" in capsys.readouterr().err
