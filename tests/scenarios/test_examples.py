"""The examples and the examples in docstrings run, on one toy run that the first of them fits."""

import doctest
import importlib
import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest

import lagsplat
from lagsplat.pipelines.diagnose_data import DiagnosisReport

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
TOY = (
    "profile=toy",
    "system=toy",
    "system.n_gaussians=128",
    "simulation.n_frames=300",
    "stage1.steps=300",
    "chart.visibility_frames=4",
    "evaluate.starts=2",
)
SEARCH = ("families=3", "places=1", "starts=1", "iterations=4", "identify_iterations=6")


def run_example(name: str, folder: Path, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *words],
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the fitted toy ``run`` of the first example and the ``diagnosis`` of the fourth."""
    folder = tmp_path_factory.mktemp("examples")
    assert "300 frames" in run_example("01_fit_a_video.py", folder, "run", *TOY)
    assert "held-out forecasts" in run_example("04_diagnose_two_csv.py", folder, ".", *SEARCH)
    return folder


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60


@pytest.mark.slow
def test_a_run_is_simulated_and_scored(place: Path) -> None:
    text = run_example("02_rollout_and_score.py", place, "run")
    assert "ae_floor" in text


@pytest.mark.slow
def test_a_run_is_pushed_and_becomes_a_page(place: Path) -> None:
    text = run_example("03_push_it.py", place, "run")
    assert "away when let go" in text
    assert (place / "run" / "run.html").stat().st_size > 10_000


@pytest.mark.slow
def test_the_demo_shows_its_own_run_where_none_is_fitted(tmp_path: Path) -> None:
    text = run_example("06_demo.py", tmp_path, "shown", "--fitted", "--no-browser")
    assert "taken instead of a fit of your own" in text
    assert (tmp_path / "shown" / "rocker.html").stat().st_size > 100_000
    diagnosis = lagsplat.load_diagnosis(tmp_path / "shown" / "diagnosis")
    assert isinstance(diagnosis, DiagnosisReport)
    assert diagnosis.effects[0].name == "viscous_damping"


@pytest.mark.slow
def test_two_tables_are_diagnosed(place: Path) -> None:
    diagnosis = lagsplat.load_diagnosis(place / "diagnosis")
    assert isinstance(diagnosis, DiagnosisReport)
    assert diagnosis.gap is not None
    assert "iframe" in diagnosis._repr_html_()
    assert (place / "candidates.png").stat().st_size


@pytest.mark.slow
@pytest.mark.parametrize("name", lagsplat.__all__)
def test_the_example_of_a_public_name(
    name: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    thing = getattr(lagsplat, name)
    thing = getattr(thing, "__wrapped__", thing) if inspect.ismodule(thing) else inspect.unwrap(thing)
    module = importlib.import_module(thing.__module__)
    finder = doctest.DocTestFinder(recurse=False)
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL
    examples = finder.find(thing, thing.__name__, module=module, globs={})
    runner = doctest.DocTestRunner(optionflags=flags)
    with capsys.disabled():
        counts = [runner.run(example, out=sys.stderr.write) for example in examples]
    assert sum(count.attempted for count in counts) > 0, f"{name} has no example"
    assert not any(count.failed for count in counts)
