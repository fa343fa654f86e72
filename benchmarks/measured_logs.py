"""Diagnoses of measured encoder logs beside sims with one known fault, made from published parameters.

Usage: ``python -m benchmarks.measured_logs FOLDER [case]...``, FOLDER with ``dfki_simple_pendulum`` and
``multiarm_pendulum``. Prints a line a case; nothing is fitted to make a case pass. The logs are measured:

- a pendulum with a geared motor, torques limited to 1 Nm (Wiebe et al. 2022, doi:10.21105/joss.03884), with
  the parameters of its ``system_identification.txt`` and ``sp_parameters_pd.yaml``;
- a pendulum that swings freely (Kaheman et al. 2022, arXiv:2205.06231), with the parameters of its
  ``EstimatedParameters_SinglePendulum.mat``.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.io import loadmat

from lagsplat.config.compose import compose
from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.pipelines.diagnosis import diagnose_files

MOTOR, FREE = "dfki_simple_pendulum", "multiarm_pendulum"
GAINS = (50.0, 4.0)  # of position [Nm/rad] and velocity [Nm s/rad]: `sp_parameters_pd.yaml`
IDENTIFIED = {"inertia": 0.0626, "weight": 0.1022 * 9.81, "viscous": 0.0471, "dry": 0.184, "offset": -0.0759}
DRIVEN = {
    "inertia": 0.6755 * 0.5**2,
    "weight": 0.6755 * 0.5 * 9.81,
    "viscous": 0.1,
    "dry": 0.0,
    "offset": 0.0,
}
SWINGING = {"inertia": 0.147585 * 0.147755**2 + 1.09119e-4, "weight": 0.147585 * 0.147755 * 9.81001}
SWINGING |= {"viscous": 2.2394e-4, "dry": 0.0, "offset": 0.0}

PROGRAM = """import numpy as np

def swing(q, v, u):
    torque = (u[..., :1] if u.shape[-1] else 0.0) - {offset} - {viscous} * v - {dry} * np.arctan(100.0 * v)
    return (torque - {weight} * np.sin(q - {rest})) / {inertia}
"""
"""The sim of every pendulum: torques [Nm], angles [rad], inertia [kg m^2], angle ``rest`` when hanging."""


@dataclass(frozen=True)
class Case:
    """A measured log, and what a sim of it lacks."""

    cause: str
    expected: tuple[str, ...]  # names in the catalogue that say the cause
    log: Callable[[Path], pd.DataFrame]
    sim: dict[str, float] | Callable[[Path], pd.DataFrame]
    """Parameters of `PROGRAM`, or recordings of the sim."""


def read_motor(name: str, *, end_s: float = np.inf) -> Callable[[Path], pd.DataFrame]:
    """A reader of the log ``name`` of the driven pendulum: t [s], q0 [rad], u0 [Nm]."""

    def read(folder: Path) -> pd.DataFrame:
        table = pd.read_csv(folder / MOTOR / f"{name}_measured.csv")
        table = table[table["time"] < end_s]
        return pd.DataFrame({"t": table["time"], "q0": table["position"], "u0": table["torque"]})

    return read


def read_commands(folder: Path) -> pd.DataFrame:
    """The log of the swing-up that fails, with the torque that its controller asked for before the limit."""
    table = pd.read_csv(folder / MOTOR / "pd_torque_limited_1Nm_measured.csv")
    stiffness, damping = GAINS
    asked = stiffness * (np.pi - table["position"]) - damping * table["velocity"]
    return pd.DataFrame({"t": table["time"], "q0": table["position"], "u0": asked})


def read_free(folder: Path) -> pd.DataFrame:
    """The free swing from 94 degrees: t [s] and q0 [rad], sampled at 1 kHz."""
    data = loadmat(folder / FREE / "SinglePendulumDataForParameterEstimation.mat", squeeze_me=True)
    return pd.DataFrame(
        {"t": np.concatenate(data["Time_id"]), "q0": np.concatenate([y[0] for y in data["Y_id"]])}
    )


def read_tail(folder: Path) -> pd.DataFrame:
    """The last small swings to rest: 40 000 counts a turn at 10 kHz, of which every tenth is kept."""
    data = loadmat(folder / FREE / "SingleDataFreeSwing_1_Dt_0_0001.mat", squeeze_me=True)
    angle, time_s = data["Theta1"]["signals"].item()["values"].item(), data["Theta1"]["time"].item()
    return pd.DataFrame({"t": time_s, "q0": angle})[::10]


CASES = {
    "coulomb_tail": Case(
        "Coulomb friction missing", ("coulomb_friction",), read_tail, {**SWINGING, "rest": np.pi}
    ),
    "coulomb": Case(
        "Coulomb friction missing", ("coulomb_friction",), read_motor("pd_sysid"), {**IDENTIFIED, "dry": 0.0}
    ),
    "viscous": Case(
        "viscous damping missing",
        ("viscous_damping",),
        read_free,
        {**SWINGING, "viscous": 0.0, "rest": np.pi},
    ),
    "payload": Case(
        "payload of 1 kg instead of the usual",
        ("mass_change", "input_gain"),
        read_motor("energy_shaping_1kg", end_s=8.0),
        read_motor("energy_shaping_defaultmass", end_s=8.0),
    ),
    "saturation": Case("torque limited to 1 Nm", ("input_saturation",), read_commands, DRIVEN),
    "offset": Case(
        "torque offset missing", ("constant_force",), read_motor("pd_sysid"), {**IDENTIFIED, "offset": 0.0}
    ),
    "frequency": Case(
        "weight 20 % too small",
        ("linear_stiffness", "mass_change"),
        read_free,
        {**SWINGING, "weight": 0.8 * SWINGING["weight"], "rest": np.pi},
    ),
    "published": Case(
        "nothing but what the published parameters are off", ("none",), read_free, {**SWINGING, "rest": np.pi}
    ),
}


def write_case(case: Case, data: Path, folder: Path) -> tuple[str, str]:
    """Write the log and the sim of a case; returns the arguments ``sim`` and ``real`` of a diagnosis."""
    real = folder / "real.csv"
    case.log(data).to_csv(real, index=False)
    if callable(case.sim):
        sim = folder / "sim.csv"
        case.sim(data).to_csv(sim, index=False)
        return str(sim), str(real)
    program = folder / "pendulum.py"
    program.write_text(PROGRAM.format(**{"rest": 0.0, **case.sim}), encoding="utf-8")
    return f"{program}:swing", str(real)


def diagnose_case(name: str, data: Path, folder: Path) -> tuple[float, Diagnosis]:
    """Seconds that the diagnosis of a case takes, and what it found."""
    sim, real = write_case(CASES[name], data, folder)
    began = time.perf_counter()
    found = diagnose_files(sim, real, folder / "out", compose().diagnose, command=f"measured log {name}")
    return time.perf_counter() - began, found


def write_row(case: Case, seconds: float, found: Diagnosis) -> str:
    """One row of the table: cause, verdict, first names, gap, seconds."""
    names = ", ".join(f"{each.name} {each.probability:.2f}" for each in found.candidates[:3])
    gap = found.gap
    sizes = (gap.before, gap.refit, gap.after, gap.floor) if gap else ()
    numbers = "/".join(f"{size:.3g}" for size in sizes) or "-"
    return f"| {case.cause} | {found.verdict} | {names} | {numbers} | {seconds:.0f} |"


def main(arguments: list[str]) -> None:
    data = Path(arguments[0])
    print(
        "| cause | verdict | most probable | gap before/refit/after/floor | seconds |\n|---|---|---|---|---:|"
    )
    for name in arguments[1:] or CASES:
        with tempfile.TemporaryDirectory() as folder:
            seconds, found = diagnose_case(name, data, Path(folder))
            print(write_row(CASES[name], seconds, found), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
