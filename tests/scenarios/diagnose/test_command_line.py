"""``lagsplat diagnose`` on files: what it writes, and how it refuses."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lagsplat.cli.main import main
from lagsplat.diagnose.core.config import VERDICT
from lagsplat.diagnose.core.result import Candidate, Diagnosis, Finding, Verdict
from lagsplat.diagnose.data_quality.checks import DataCheck, PreparedSide
from lagsplat.diagnose.data_quality.compatibility import MOSTLY_OUTSIDE_CHECK
from lagsplat.diagnose.data_quality.noise import MeasurementNoise
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.residual.error_budget import PerceptionQuality
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.pipelines.diagnosis import discount_image_error, flag_extrapolation, withhold_verdict
from tests.unit.diagnose.toys import film, oscillator, own, wave

RIVALS = ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "input_lag")
QUICK = (
    f"diagnose.without=[{','.join(sorted(set(catalogue()) - set(RIVALS)))}]",
    "diagnose.families=2",
    "diagnose.starts=1",
    "diagnose.places=1",
    "diagnose.always_fitted=[]",
)


def written(motion: Trajectory, path: Path, **changes: Sequence[float] | float) -> Path:
    table = pd.DataFrame({"t": motion.time_s, "q0": motion.q[:, 0], "u0": motion.u[:, 0]})
    table.assign(**changes).to_csv(path, index=False)
    return path


def dragged(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """With quadratic drag."""
    return own(q, v, u) - 0.4 * abs(v) * v, []


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("pair")
    sim = written(film(u=wave(7), seconds=14.0, noise=0.003), folder / "sim.csv")
    return sim, written(film(dragged, u=wave(4), seconds=14.0, noise=0.003, seed=1), folder / "real.csv")


def test_a_pair_of_tables_becomes_a_verdict_with_its_files(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sim, real = pair
    assert main(["diagnose", f"sim={sim}", f"real={real}", f"out={tmp_path / 'd'}", *QUICK]) == 0
    told = json.loads((tmp_path / "d" / "diagnosis.json").read_text())
    assert told["verdict"] == "effect"
    assert told["effects"][0]["name"] == "quadratic_drag"
    assert sum(one["probability"] for one in told["effects"]) == pytest.approx(1.0, abs=1e-6)
    coefficient = told["effects"][0]["parameters"]["coefficient"]["value"]
    assert coefficient == pytest.approx(0.4, rel=0.1)
    assert {path.name for path in (tmp_path / "d").iterdir()} >= {
        "diagnosis.json",
        "report.html",
        "rollouts.csv",
        "augmented.safetensors",
    }
    told_now = capsys.readouterr()
    lines = told_now.out.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["verdict", "gap", "where", "shrinks", "next"]
    assert "drag" in lines[0]
    assert str(tmp_path / "d" / "report.html") in lines[-1]
    assert told_now.err.index("data: ") < told_now.err.index("quadratic drag")
    assert told["files"] == []
    planned = told["next_experiments"]
    assert len(planned["between"]) == 2
    played = [each for each in planned["suggestions"] if each["kind"] not in ("release", "known_payload")]
    assert planned["reason"] or played
    for number, each in enumerate(planned["suggestions"], start=1):
        inputs = tmp_path / "d" / f"next_experiment_{number}.csv"
        out = tmp_path / "d" / f"next_{number}.csv"
        run = f"run={tmp_path / 'd' / 'augmented.safetensors'}"
        assert main(["simulate", run, f"input={inputs}", f"out={out}"]) == 0
        assert pd.read_csv(out)["t"].iloc[-1] == pytest.approx(each["duration_s"])


def test_several_files_are_one_diagnosis_that_names_the_odd_one(
    pair: tuple[Path, Path], tmp_path: Path
) -> None:
    def softer(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
        """Drag of another size."""
        return own(q, v, u) - 1.2 * abs(v) * v, []

    sim, _ = pair
    for i, law in enumerate((dragged, dragged, softer)):
        motion = film(law, u=wave(4 + i), seconds=10.0, noise=0.003, seed=i)
        written(motion, tmp_path / f"real_{i}.csv")
    out = tmp_path / "d"
    assert main(["diagnose", f"sim={sim}", f"real={tmp_path}/real_*.csv", f"out={out}", *QUICK]) == 0
    told = json.loads((out / "diagnosis.json").read_text())
    assert [Path(each["file"]).name for each in told["files"]] == [f"real_{i}.csv" for i in range(3)]
    odd = told["files"][2]
    assert odd["own_lead"] == max(each["own_lead"] for each in told["files"])
    assert "another state of the mechanism: coefficient" in odd["disagrees"]
    assert any("real_2.csv disagrees with the other files" in text for text in told["warnings"])
    assert all(each["before"] > each["floor"] for each in told["files"])


def refused(capsys: pytest.CaptureFixture[str], out: Path, *words: str) -> str:
    assert main(["diagnose", *words, f"out={out}", *QUICK]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert not (out / "diagnosis.json").exists()
    assert "Traceback" not in told.err
    return told.err


def test_what_is_not_there_is_refused_by_name(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sim, real = pair
    out = tmp_path / "d"
    assert "nowhere.csv" in refused(capsys, out, f"sim={sim}", f"real={tmp_path / 'nowhere.csv'}")
    assert "real=" in refused(capsys, out, f"sim={sim}")
    assert "sim=" in refused(capsys, out, f"real={real}")
    assert "stage2.epochs" in refused(capsys, out, f"sim={sim}", f"real={real}", "stage2.epochs=3")


def test_other_coordinates_than_the_sims_are_refused(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sim, _ = pair
    motion = film(u=wave(4), seconds=8.0)
    two = written(motion, tmp_path / "two.csv", q1=motion.q[:, 0])
    assert "coordinate" in refused(capsys, tmp_path / "d", f"sim={sim}", f"real={two}")
    mute = tmp_path / "mute.csv"
    pd.DataFrame({"t": motion.time_s, "q0": motion.q[:, 0]}).to_csv(mute, index=False)
    assert "input" in refused(capsys, tmp_path / "d", f"sim={sim}", f"real={mute}")


def test_tables_that_hold_no_motion_are_refused(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sim, _ = pair
    motion = film(u=wave(4), seconds=8.0)
    empty = written(motion, tmp_path / "empty.csv", q0=np.nan)
    assert "q0" in refused(capsys, tmp_path / "d", f"sim={sim}", f"real={empty}")
    short = written(motion.pieces([(0, 6)]), tmp_path / "short.csv")
    assert "6 samples" in refused(capsys, tmp_path / "d", f"sim={sim}", f"real={short}")
    words = written(motion, tmp_path / "words.csv", u0="on")
    assert "u0" in refused(capsys, tmp_path / "d", f"sim={sim}", f"real={words}")
    back = written(motion, tmp_path / "back.csv", t=motion.time_s[::-1])
    assert "increase" in refused(capsys, tmp_path / "d", f"sim={sim}", f"real={back}")
    still = written(motion, tmp_path / "still.csv", q0=0.3)
    assert "still.csv" in refused(capsys, tmp_path / "d", f"sim={sim}", f"real={still}")


def test_a_verdict_that_the_data_forbid_keeps_no_name_above_the_rest() -> None:
    rows = (Candidate("coulomb_friction", 0.97), Candidate("creep", 0.02), Candidate("none", 0.01))
    sure = Diagnosis("effect", rows, ("coulomb_friction",), None, None, (), (), (), (), (), {})
    flat = withhold_verdict(sure)
    assert flat.verdict == "undetermined"
    assert flat.combination == ()
    assert sum(one.probability for one in flat.candidates) == pytest.approx(1.0)
    assert [one.name for one in flat.candidates] == [one.name for one in rows]
    assert max(one.probability for one in flat.candidates) == pytest.approx(VERDICT.max_withheld_probability)


@pytest.mark.parametrize(
    ("verdict", "check", "held"),
    [
        ("unknown", MOSTLY_OUTSIDE_CHECK, False),
        ("unknown", "outside the sim", True),
        ("effect", MOSTLY_OUTSIDE_CHECK, True),
    ],
)
def test_what_a_sim_misses_where_it_was_not_seen_is_not_called_unknown_physics(
    verdict: Verdict, check: str, held: bool
) -> None:
    rows = (Candidate(verdict, 0.9), Candidate("creep", 0.1))
    found = Diagnosis(verdict, rows, (), None, None, (), (), (), (), (), {})
    finding = Finding("warn", check, "real", "60 % lie outside", "there it is extrapolated", "record a sim")
    checked = DataCheck(None, PreparedSide((), (), None, MeasurementNoise(*np.zeros((3, 1)))), (finding,))
    assert ("undetermined" not in flag_extrapolation(found, checked).checks) == held


@pytest.mark.parametrize(("suspect", "misfit"), [(True, 2.0 * 3.0), (False, 2.0)])
def test_a_sim_misses_more_where_its_pictures_are_drawn_worse(suspect: bool, misfit: float) -> None:
    sim = replace(EstimatedSimulator.exact(oscillator()), misfit=2.0)
    assert discount_image_error(sim, None) is sim
    assert discount_image_error(sim, PerceptionQuality(3.0, 0.0, suspect)).misfit == pytest.approx(misfit)
