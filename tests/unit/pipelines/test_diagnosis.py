"""lagsplat diagnose on input that cannot be diagnosed: it says why, exits with 2 and leaves no diagnosis."""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest

from lagsplat.cli.main import main
from lagsplat.config.compose import ConfigError, compose
from lagsplat.diagnose.core.result import Candidate
from lagsplat.diagnose.data_quality.checks import check_data
from lagsplat.diagnose.simulators.python_model import load_python
from lagsplat.io.trajectory.trajectory import read_trajectory_file
from lagsplat.pipelines.diagnosis import (
    diagnose_files,
    find_likeliest_level,
    require_writable,
    share_components,
)

HEADER = "t,q0,u0"


def swing(n: int = 400, *, seed: int = 0) -> np.ndarray:
    """A driven pendulum of 16/s^2 at 40 Hz, (n, 3): t, q0, u0; with a little noise."""
    phases, dt = np.random.default_rng(seed).uniform(0, 6, 3), 1 / 40
    t = np.arange(n) * dt
    u = sum(np.sin(2 * np.pi * f * t + phase) for f, phase in zip((0.23, 0.67, 1.3), phases, strict=True))
    q, v, x, y = np.zeros(n), np.zeros(n), 0.0, 0.0
    for i in range(n):
        q[i], v[i] = x, y
        for _ in range(10):
            y += dt / 10 * (2 * u[i] - 16 * np.sin(x) - 0.2 * y)
            x += dt / 10 * y
    return np.stack([t, q + 0.002 * np.random.default_rng(seed).standard_normal(n), u], axis=1)


def write(path: Path, rows: np.ndarray, header: str = HEADER) -> Path:
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


@pytest.fixture
def sim(tmp_path: Path) -> Path:
    return write(tmp_path / "sim.csv", swing(seed=1))


def refusal(capsys: pytest.CaptureFixture[str], sim: Path, real: object, *words: str) -> str:
    out = sim.parent / "out"
    assert main(["diagnose", f"sim={sim}", f"real={real}", f"out={out}", *words]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "Traceback" not in told.err
    assert not (out / "diagnosis.json").exists()
    return told.err


def test_files_that_are_not_there(sim: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "nowhere.csv: no such file" in refusal(capsys, sim, sim.parent / "nowhere.csv")
    assert "gone.csv: no such file" in refusal(capsys, sim.parent / "gone.csv", sim)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty"),
        (HEADER + "\n", "no row"),
        ("t,angle\n0,1\n1,2\n", "q0"),
        (HEADER + "\n0,1,2\n0.1,1", "line 3: 2 cells"),
        (HEADER + "\n0,left,1\n1,right,1\n", "left"),
        ("\x00\x01\xff", "bad.csv"),
    ],
    ids=["empty", "header only", "no coordinate", "cut off", "words", "bytes"],
)
def test_files_that_hold_no_motion(
    sim: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    path = sim.parent / "bad.csv"
    path.write_text(text, encoding="latin-1")
    assert said in refusal(capsys, sim, path)


def test_an_input_without_a_number_names_its_column(sim: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = swing()
    rows[:, 2] = np.nan
    assert "u0" in refusal(capsys, sim, write(sim.parent / "real.csv", rows))


def test_sides_that_do_not_share_coordinates(sim: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = swing()
    both = write(sim.parent / "both.csv", np.insert(rows, 2, rows[:, 1], axis=1), "t,q0,q1,u0")
    assert "q1" in refusal(capsys, sim, both)


def test_an_input_that_one_side_lacks(sim: Path, capsys: pytest.CaptureFixture[str]) -> None:
    free = write(sim.parent / "free.csv", swing()[:, :2], "t,q0")
    assert "u0" in refusal(capsys, sim, free)


@pytest.mark.parametrize("rows", [1, 8])
def test_too_few_rows(sim: Path, capsys: pytest.CaptureFixture[str], rows: int) -> None:
    assert refusal(capsys, sim, write(sim.parent / "few.csv", swing()[:rows]))


def test_times_that_run_back_without_a_segment(sim: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = swing()
    rows[:, 0] %= 4.0
    assert "segment" in refusal(capsys, sim, write(sim.parent / "real.csv", rows))


def test_each_segment_may_begin_its_own_clock(sim: Path) -> None:
    rows = swing(800)
    segment = np.arange(800) // 400
    rows[:, 0] -= rows[400 * segment, 0]
    path = write(sim.parent / "real.csv", np.column_stack([rows, segment]), HEADER + ",segment")
    with pytest.warns(UserWarning, match="begin their own clock"):
        real = read_trajectory_file(path)
    assert check_data([read_trajectory_file(sim)], [real]).real.motions[0].segments == ((0, 400), (400, 800))


def test_a_place_that_cannot_take_results(sim: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taken = sim.parent / "taken"
    taken.write_text("mine")
    for out in (taken, taken / "below"):
        assert main(["diagnose", f"sim={sim}", f"real={sim}", f"out={out}"]) == 2
        assert "is a file" in capsys.readouterr().err.replace("a file stands there", "is a file")
    assert taken.read_text() == "mine"
    if os.geteuid() != 0:
        sim.parent.chmod(0o500)
        with pytest.raises(PermissionError, match="cannot be written"):
            require_writable(sim.parent / "new")
        sim.parent.chmod(0o700)


def test_an_older_diagnosis_does_not_pass_for_a_refused_one(
    sim: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = sim.parent / "out" / "diagnosis.json"
    old.parent.mkdir()
    old.write_text("{}")
    refusal(capsys, sim, sim.parent / "nowhere.csv")


def test_columns_are_named_on_the_command_line(sim: Path) -> None:
    real = write(sim.parent / "log.csv", swing(), "time,angle,torque")
    own = "diagnose.columns={t: time, q0: angle, u0: torque}"
    assert compose(own).diagnose.columns == {"t": "time", "q0": "angle", "u0": "torque"}
    assert compose("diagnose.columns.q0=angle").diagnose.columns == {"q0": "angle"}
    assert read_trajectory_file(real, columns=compose(own).diagnose.columns).q_names == ("q0",)
    with pytest.raises(ConfigError, match="colums"):
        compose("diagnose.colums={t: time}")


@pytest.mark.parametrize(
    ("word", "said"),
    [("diagnose.nope=1", "nope"), ("diagnose.input_hold=cubic", "linear or zoh"), ("stage1=paper", "stage1")],
)
def test_settings_that_are_not_taken(
    sim: Path, capsys: pytest.CaptureFixture[str], word: str, said: str
) -> None:
    assert said in refusal(capsys, sim, sim, word)


def test_sims_that_are_no_sims(sim: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = sim.parent / "broken.py"
    broken.write_text("raise RuntimeError('boom')\n")
    assert "boom" in refusal(capsys, Path(f"{broken}:pendulum"), sim)
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_python(f"{sim.parent / 'missing.py'}:pendulum")
    model = sim.parent / "model.xml"
    model.write_text("no model")
    assert "model.xml" in refusal(capsys, model, sim)


def test_what_is_warned_of_is_told_and_numbers_that_overflow_are_not(
    sim: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def searched(*_: object) -> None:
        warnings.warn("rows are left out", stacklevel=1)
        np.exp(np.array([1e9]))
        raise ValueError("enough")

    monkeypatch.setattr("lagsplat.pipelines.diagnosis._diagnose_arguments", searched)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(ValueError, match="enough"):
            diagnose_files(str(sim), str(sim), sim.parent / "out", compose().diagnose, command="")
    assert [one for one in caught if one.category is RuntimeWarning] == []


def test_the_level_is_that_of_the_likeliest_causes_together() -> None:
    found = [("unknown", 0.5), ("coulomb_friction", 0.2), ("input_lag", 0.15), ("input_delay", 0.15)]
    assert find_likeliest_level([Candidate(name, chance) for name, chance in found]) == "actuation"
    assert find_likeliest_level([Candidate("frame_drops", 0.4), Candidate("none", 0.6)]) == "perception"
    assert find_likeliest_level([Candidate("none", 1.0)]) == "dynamics"


def test_kinds_of_terms_share_the_probability_of_a_cause() -> None:
    found = [("none", 0.2), ("unknown", 0.2), ("coulomb_friction", 0.3), ("viscous_damping", 0.1)]
    found += [("input_lag", 0.1), ("frame_drops", 0.1)]
    shares = share_components([Candidate(name, chance) for name, chance in found])
    known = {name: share for name, share in shares.items() if share}
    assert known == pytest.approx({"dissipative": 0.5, "actuation": 0.125, "unexplained": 0.25})
    assert not any(share_components([Candidate("none", 1.0)]).values())
