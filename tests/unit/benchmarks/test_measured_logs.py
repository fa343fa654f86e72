"""Sims beside measured logs: they run, with the zero, sign and units of their log."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from benchmarks.measured_logs import CASES, DRIVEN, SWINGING, Case, write_case, write_row
from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.data_quality.checks import check_data
from lagsplat.diagnose.effects.registry import list_names
from lagsplat.diagnose.simulators.python_model import load_python
from lagsplat.io.read import read_trajectory
from tests.unit.report.diagnosis import made_diagnoses

LOGS = Path(os.environ.get("MEASURED_LOGS", "measured_logs"))
measured = pytest.mark.skipif(not LOGS.is_dir(), reason="MEASURED_LOGS names no folder of measured logs")


def made_log(_: Path) -> pd.DataFrame:
    time_s = np.arange(50) * 0.02
    return pd.DataFrame({"t": time_s, "q0": np.sin(time_s), "u0": np.cos(time_s)})


def test_a_case_becomes_a_program_and_a_table(tmp_path: Path) -> None:
    sim, real = write_case(Case("nothing", ("none",), made_log, DRIVEN), tmp_path, tmp_path)
    accelerate = load_python(sim)
    q, v, u = np.array([0.3]), np.array([2.0]), np.array([0.5])
    expected = (0.5 - 0.1 * 2.0 - 0.6755 * 0.5 * 9.81 * np.sin(0.3)) / (0.6755 * 0.25)
    assert accelerate(q, v, u)[0] == pytest.approx(expected)
    assert accelerate(q, v, np.zeros(0))[0] == pytest.approx(expected - 0.5 / (0.6755 * 0.25))
    assert read_trajectory(real).u_names == ("u0",)


def test_a_sim_may_be_recordings(tmp_path: Path) -> None:
    sim, real = write_case(Case("nothing", ("none",), made_log, made_log), tmp_path, tmp_path)
    np.testing.assert_array_equal(read_trajectory(sim).q, read_trajectory(real).q)


def test_what_is_expected_is_in_the_catalogue_and_a_row_has_every_number() -> None:
    assert {name for case in CASES.values() for name in case.expected} <= set(list_names())
    found: Diagnosis = made_diagnoses.every_kind()["single"]
    row = write_row(CASES["viscous"], 12.4, found)
    assert row.startswith("| viscous damping missing | effect | coulomb_friction 1.00")
    assert row.endswith("| 12 |")
    assert " - " in write_row(CASES["viscous"], 12.4, replace(found, gap=None))


@measured
def test_the_published_pendulum_has_the_zero_sign_and_units_of_its_log(tmp_path: Path) -> None:
    """It follows the first swing. Over four it drifts by 0.16 rad: the published parameters are not exact."""
    sim, real = write_case(CASES["published"], LOGS, tmp_path)
    motion, accelerate = read_trajectory(real), load_python(sim)
    time_s, q = motion.time_s[:900], motion.q[:900, 0]
    rate = float(np.polyfit(time_s[:40], q[:40], 2)[1])

    def follow(t: float, y: np.ndarray) -> list[float]:
        return [y[1], float(accelerate(y[:1], y[1:], np.zeros(0))[0])]

    path = solve_ivp(follow, (time_s[0], time_s[-1]), [q[0], rate], t_eval=time_s, rtol=1e-8).y[0]
    assert np.abs(path - q).max() < 0.02 * np.ptp(q)
    assert SWINGING["viscous"] > 0.0


@measured
@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("coulomb_tail", set()),
        ("coulomb", {"too short", "undeclared cut"}),
        ("payload", {"short"}),
        ("saturation", {"closed_loop"}),
    ],
)
def test_counts_of_encoders_are_neither_jumps_nor_losses(name: str, told: set[str], tmp_path: Path) -> None:
    sim, real = write_case(CASES[name], LOGS, tmp_path)
    nominal = (read_trajectory(sim),) if sim.endswith(".csv") else ()
    checked = check_data(nominal, (read_trajectory(real),))
    assert {finding.check for finding in checked.findings if finding.level != "note"} == told
