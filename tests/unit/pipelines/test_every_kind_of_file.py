"""A swing that rubs, in files of every kind: what `inspect` says of them is what `diagnose` takes."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from lagsplat.cli.main import main
from lagsplat.config.compose import compose
from lagsplat.pipelines.diagnosis import run_diagnosis
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs
from tests.unit.io.robot_log.bag_files import JOINT, STORE, header, write_bag
from tests.unit.io.robot_log.mcap_files import START_NS

RATE_HZ, SECONDS = 40.0, 8.0
SIM = "def swing(q, v, u):\n    return -36.0 * q - 0.2 * v\n"
QUICK = [f"diagnose.{item}" for item in ("families=1", "starts=1", "iterations=3", "places=1")]


def record() -> SimpleNamespace:
    """Times, angles and rates of a swing that dry friction brakes, with a little noise."""
    step, state, rows = 1.0 / (20.0 * RATE_HZ), np.array([1.0, 0.0]), []
    for k in range(round(SECONDS / step)):
        if k % 20 == 0:
            rows.append(state.copy())
        acceleration = -36.0 * state[0] - 0.2 * state[1] - 0.8 * np.tanh(state[1] / 1e-3)
        state[1] += step * acceleration
        state[0] += step * state[1]
    q, v = np.array(rows).T
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(q))
    return SimpleNamespace(t=np.arange(len(q)) / RATE_HZ, q=q + noise, v=v)


def write_csv(path: Path, log: SimpleNamespace) -> Path:
    pd.DataFrame({"time": log.t, "angle": log.q}).to_csv(path / "log.csv", index=False)
    return path / "log.csv"


def write_parquet(path: Path, log: SimpleNamespace) -> Path:
    pd.DataFrame({"stamp": log.t, "position": log.q}).to_parquet(path / "log.parquet")
    return path / "log.parquet"


def write_npz(path: Path, log: SimpleNamespace) -> Path:
    np.savez(path / "log.npz", t=log.t, q=log.q[:, None])
    return path / "log.npz"


def write_matlab(path: Path, log: SimpleNamespace) -> Path:
    savemat(path / "log.mat", {"time": log.t, "theta": log.q})
    return path / "log.mat"


def write_hdf5(path: Path, log: SimpleNamespace) -> Path:
    with h5py.File(path / "log.h5", "w") as file:
        file["time"], file["joint/angle"] = log.t, log.q
    return path / "log.h5"


def write_robomimic(path: Path, log: SimpleNamespace) -> Path:
    with h5py.File(path / "demos.hdf5", "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": "Swing", "env_kwargs": {"control_freq": RATE_HZ}})
        demo = data.create_group("demo_0")
        demo.attrs["num_samples"] = len(log.q)
        demo["obs/joint_pos"] = log.q[:, None]
    return path / "demos.hdf5"


def write_ros_bag(path: Path, log: SimpleNamespace, storage: str) -> Path:
    none, rows = np.zeros(0), []
    for t, q, v in zip(log.t, log.q, log.v, strict=True):
        ns = round(1e9 * t)
        message = STORE.types[JOINT](header(ns + START_NS), ["swing"], np.array([q]), np.array([v]), none)
        rows.append(("/joint_states", JOINT, ns, message))
    return write_bag(path / "bag", rows, storage)


def write_sqlite_bag(path: Path, log: SimpleNamespace) -> Path:
    return write_ros_bag(path, log, "sqlite3")


def write_mcap(path: Path, log: SimpleNamespace) -> Path:
    return next(write_ros_bag(path, log, "mcap").glob("*.mcap"))


def write_sysid_series(path: Path, log: SimpleNamespace) -> Path:
    sysid, mujoco = pytest.importorskip("mujoco.sysid"), pytest.importorskip("mujoco")
    joint = '<body><joint name="a" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.3"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{joint}</worldbody></mujoco>")
    sysid.TimeSeries.from_names(log.t, log.q[:, None], model, ["a_qpos"]).save_to_disk(path / "series.npz")
    return path / "series.npz"


WRITERS = (
    write_csv, write_parquet, write_npz, write_matlab, write_hdf5, write_robomimic, write_sqlite_bag,
    write_mcap, write_sysid_series,
)  # fmt: skip


@pytest.mark.filterwarnings("ignore:demos.hdf5. samples are 0.025 s apart")
@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__.removeprefix("write_"))
def test_what_inspect_says_is_what_diagnose_takes(
    write: Callable[[Path, SimpleNamespace], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.py").write_text(SIM, encoding="utf-8")
    path = write(tmp_path, record())
    assert main(["inspect", str(path)]) == 0
    told = capsys.readouterr().out.replace("\\\n", "")
    (line,) = [line for line in told.splitlines() if "lagsplat diagnose" in line]
    sim, real, *settings = shlex.split(line[line.index("sim=") :])
    assert (sim, real) == ("sim=SIM", f"real={path}")
    config = compose(*settings, *QUICK).diagnose
    inputs = open_diagnosis_inputs(f"{tmp_path / 'arm.py'}:swing", str(path), config)
    found = run_diagnosis(inputs, config, report_progress=lambda _: None).diagnosis
    assert (found.verdict, found.candidates[0].name) == ("effect", "coulomb_friction")
