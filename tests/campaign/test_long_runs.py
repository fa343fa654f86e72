"""Long runs in miniature: what is found, and the live view, fits and a crowd for some seconds."""

import sys
from dataclasses import replace
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

import pytest

from tests.campaign import long_runs
from tests.campaign.long_runs import Sample, judge, run_fits, run_sockets, run_view, train_endlessly
from tests.unit.evaluate import tiny_run
from tests.unit.stage2.test_finished_fits import POLYNOMIAL, SHORT, config, fit

LOOSE = 0.6  # some seconds are too short for five percent
STEADY = Sample("view", 0.0, 500.0, 300.0, 250.0, 9, 11, 0.0, 0, 0, 5, 0.3, 5.0)
linux = pytest.mark.skipif(sys.platform != "linux", reason="processes are watched in /proc")


def samples(**growth: float) -> list[Sample]:
    """A hundred samples whose columns grow by these shares, ``cost`` being the processor time of one."""
    cost, found, cpu_s = growth.pop("cost", 0.0), [], 0.0
    for i in range(100):
        cpu_s += 1.0 + 0.01 * i * cost
        grown = {name: getattr(STEADY, name) * (1.0 + 0.01 * i * share) for name, share in growth.items()}
        found.append(replace(STEADY, after_s=float(i), done=20 * i, cpu_s=cpu_s, **grown))
    return found


@pytest.mark.parametrize(
    ("growth", "found"),
    [
        ({}, 0),
        ({"rss_mb": 0.04, "own_mb": -0.3, "cost": 0.04}, 0),
        ({"rss_mb": 0.09}, 1),
        ({"own_mb": 0.09}, 1),
        ({"cost": 0.09}, 1),
        ({"threads": 1.0}, 1),
        ({"open_files": 0.3}, 1),
        ({"kept_files": 1.0, "kept_mb": 20.0}, 2),
    ],
)
def test_what_grows_is_found(growth: dict[str, float], found: int) -> None:
    assert len(judge(samples(**growth), 0.05)) == found


def test_more_pictures_for_the_same_steps_are_no_slowdown() -> None:
    lively = [replace(one, pictures=round(one.done**1.3)) for one in samples(cost=0.2)]
    assert judge(lively, 0.05) == []
    steady = [replace(one, pictures=one.done) for one in samples(cost=0.2)]
    assert len(judge(steady, 0.05)) == 1


def test_what_stops_is_found() -> None:
    halted = [replace(one, done=min(one.done, 1000)) for one in samples()]
    assert judge(halted, 0.05) == ["view: processor time over its mean: nothing late"]
    assert judge([replace(one, done=0) for one in samples()], 0.05) == ["view: nothing was done"]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    tiny_run.save_run(tmp_path / "run")
    return tmp_path


@linux
def test_a_live_view_is_visited_for_seconds(place: Path) -> None:
    assert run_view(8.0, 1, place, LOOSE, place / "view.csv") == []
    rows = (place / "view.csv").read_text().splitlines()
    assert rows[0].startswith("run,after_s,rss_mb")
    assert len(rows) > 5


def fit_law(place: str, done: "Synchronized[int]") -> None:
    """Fit a small law over and over, counting the fits."""
    while True:
        fit(config(form=POLYNOMIAL, likelihood=SHORT), Path(place) / "fits.pt", str(done.value))
        done.value += 1


@linux
def test_fits_run_for_seconds(tmp_path: Path) -> None:
    fits = {"training": train_endlessly, "laws": fit_law}
    assert run_fits(8.0, tmp_path, LOOSE, tmp_path / "fit.csv", fits) == []


@linux
def test_a_crowd_comes_and_goes(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long_runs, "STORM_S", 4.0)
    monkeypatch.setattr(long_runs, "REST_SAMPLES", 2)
    assert run_sockets(40, 1, place, LOOSE, place / "sockets.csv") == []
