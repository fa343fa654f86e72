"""lagsplat diagnose on a URDF: what rubs in the log is found, and the patch is an MJCF."""

import json
from pathlib import Path

import pytest

from lagsplat.config.compose import compose
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.pipelines.diagnosis import diagnose_files
from tests.unit.diagnose.arms import record_arm, write_log
from tests.unit.diagnose.simulators.urdf_files import TWO, with_fault, write_mjcf, write_urdf

mujoco = pytest.importorskip("mujoco")
KEPT = ("coulomb_friction", "viscous_damping", "input_gain", "mass_change")


def test_a_log_of_a_rubbing_arm_against_its_urdf(tmp_path: Path) -> None:
    gears = (1.0, 2.0)
    sim = write_urdf(tmp_path / "arm.urdf", TWO, reductions=gears)
    real = write_mjcf(tmp_path / "real.xml", with_fault(TWO, 1, friction=0.15), reductions=gears)
    write_log(tmp_path / "log.csv", record_arm(real, 12.0, seed=5))
    config = compose(
        f"diagnose.without=[{','.join(name for name in catalogue() if name not in KEPT)}]",
        "diagnose.input_hold=zoh",
        "diagnose.families=2",
        "diagnose.places=2",
        "diagnose.starts=1",
        "diagnose.iterations=6",
    ).diagnose
    out = tmp_path / "out"
    diagnosis = diagnose_files(str(sim), str(tmp_path / "log.csv"), out, config, command="lagsplat diagnose")
    assert (diagnosis.verdict, diagnosis.candidates[0].name) == ("effect", "coulomb_friction")
    assert diagnosis.candidates[0].coordinate == "q1"
    patched = mujoco.MjModel.from_xml_path(str(out / "patched.xml"))
    assert patched.joint("j1").frictionloss[0] == pytest.approx(0.15, rel=0.2)
    assert patched.joint("j0").frictionloss[0] == 0.0
    assert patched.actuator("m1").gear[0] == 2.0
    stored = json.loads((out / "diagnosis.json").read_text())
    assert stored["checks"]["mujoco"][-1].startswith("patched.xml is an MJCF, as a URDF has no place")
    told = [
        each["what"] for each in stored["checks"]["findings"] if each["check"] == "URDF as MuJoCo reads it"
    ]
    assert any("mechanicalReduction: m1 (2 at j1)" in text for text in told)
