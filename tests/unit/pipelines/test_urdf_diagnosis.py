"""lagsplat diagnose on a URDF: what rubs is found, and the patch is an MJCF that mujoco.sysid can load."""

import json
from pathlib import Path

import numpy as np
import pytest

from lagsplat.cli.main import main
from lagsplat.config.compose import compose
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.simulators.mujoco_model import TRANSLATED
from lagsplat.io.files.artifact import save_artifact
from lagsplat.io.mujoco.model import load_mujoco
from lagsplat.io.read import read_trajectory
from lagsplat.pipelines.diagnosis import diagnose_files
from lagsplat.pipelines.sysid_export import export_sysid
from tests.unit.diagnose.arms import record_arm, write_log
from tests.unit.io.mujoco.urdf_files import TWO, with_fault, write_mjcf, write_urdf

mujoco = pytest.importorskip("mujoco")
sysid = pytest.importorskip("mujoco.sysid")
KEPT = ("coulomb_friction", "viscous_damping", "input_gain", "mass_change")


QUICK = (
    f"diagnose.without=[{','.join(name for name in catalogue() if name not in KEPT)}]",
    "diagnose.always_fitted=[coulomb_friction]",
    "diagnose.input_hold=zoh",
    "diagnose.max_coupled=1",  # each joint by itself, which is quicker
    "diagnose.families=2",
    "diagnose.places=1",
    "diagnose.starts=1",
    "diagnose.iterations=6",
)


def test_a_log_of_a_rubbing_arm_against_its_urdf(tmp_path: Path) -> None:
    gears = (1.0, 2.0)
    sim = write_urdf(tmp_path / "arm.urdf", TWO, reductions=gears)
    real = write_mjcf(tmp_path / "real.xml", with_fault(TWO, 1, friction=0.15), reductions=gears)
    log = write_log(tmp_path / "log.csv", record_arm(real, 12.0, seed=5))
    out, config = tmp_path / "out", compose(*QUICK).diagnose
    diagnosis = diagnose_files(str(sim), str(log), out, config, command="lagsplat diagnose")
    assert (diagnosis.verdict, diagnosis.candidates[0].name) == ("effect", "coulomb_friction")
    assert diagnosis.candidates[0].coordinate == "j1"
    patched = mujoco.MjModel.from_xml_path(str(out / "patched.xml"))
    assert patched.joint("j1").frictionloss[0] == pytest.approx(0.15, rel=0.2)
    assert patched.joint("j0").frictionloss[0] == 0.0
    assert patched.actuator("m1").gear[0] == 2.0
    stored = json.loads((out / "diagnosis.json").read_text())
    assert any(
        "patched.xml is an MJCF, as a URDF has no place" in line for line in stored["checks"]["mujoco"]
    )
    told = [each["what"] for each in stored["checks"]["findings"] if each["check"] == TRANSLATED]
    assert any("mechanicalReduction: m1 (2 at j1)" in text for text in told)
    check_export(out, tmp_path / "sysid", patched)


def check_export(diagnosis: Path, out: Path, patched: object) -> None:
    """What is exported is loaded by the toolbox's own functions, and is the patched model again."""
    assert main(["export", str(diagnosis), "--sysid", f"out={out}"]) == 0
    found = sysid.ParameterDict.load_from_disk(out / "params_x_hat.yaml")
    names: list[str] = found.keys()  # a list of the toolbox's own
    assert "j1_frictionloss" in names
    assert {name.partition("_")[0] for name in names} <= {"j0", "j1"}
    assert found["j1_frictionloss"].value[0] == pytest.approx(patched.joint("j1").frictionloss[0])  # type: ignore[attr-defined]
    start = sysid.ParameterDict.load_from_disk(out / "params_x_0.yaml")
    assert start["j1_frictionloss"].value[0] == 0.0
    measured = sysid.TimeSeries.load_from_disk(out / "log_measured.npz")
    control = sysid.TimeSeries.load_from_disk(out / "log_control.npz")
    assert list(measured.signal_mapping) == ["j0_qpos", "j1_qpos"]
    assert list(control.signal_mapping) == ["m0_ctrl", "m1_ctrl"]
    assert (out / "arm.xml").read_text() == (diagnosis / "patched.xml").read_text()
    again = load_mujoco(diagnosis.parent / "arm.urdf", parameters=str(out / "params_x_hat.yaml")).model
    np.testing.assert_allclose(again.dof_frictionloss, patched.dof_frictionloss, rtol=1e-5)  # type: ignore[attr-defined]
    log = read_trajectory(diagnosis.parent / "log.csv")
    exported = read_trajectory(out / "log_measured.npz")
    np.testing.assert_array_equal(exported.q, log.q)
    np.testing.assert_array_equal(exported.u, log.u)


def test_what_cannot_be_exported_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(tmp_path), "--sysid"]) == 2
    assert "augmented.safetensors: not there; name the folder of a diagnosis" in capsys.readouterr().err
    header = {
        "kind": "augmented",
        "schema": 1,
        "sim": str(tmp_path / "sim.csv"),
        "real": "real.csv",
        "config": {},
    }
    (tmp_path / "sim.csv").write_text("t,q0\n0,1\n")
    save_artifact(tmp_path / "augmented.safetensors", {"x": np.zeros(1)}, header)
    with pytest.raises(
        ValueError, match=r"its sim .*sim\.csv is a trajectory; mujoco.sysid identifies MuJoCo"
    ):
        export_sysid(tmp_path, tmp_path / "out")
