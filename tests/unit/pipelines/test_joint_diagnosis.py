"""lagsplat diagnose on arms of many joints: each joint by itself, and one diagnosis of all."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.diagnose.augmented.model import load_augmented
from lagsplat.diagnose.augmented.simulate import AppliedSignals, simulate_augmented
from lagsplat.diagnose.core.result import Candidate, Diagnosis, Gap, Interval
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.io.trajectory.trajectory import read_trajectory_file
from lagsplat.pipelines.diagnosis import diagnose_files
from lagsplat.pipelines.diagnosis_inputs import open_inputs_by_joint
from lagsplat.pipelines.joint_diagnosis import JOINT_INPUTS, rank_joint
from lagsplat.report.diagnosis.lines import write_lines
from tests.unit.diagnose.arms import record_arm, write_arm, write_log

mujoco = pytest.importorskip("mujoco")
KEPT = ("coulomb_friction", "viscous_damping", "input_gain", "mass_change")
QUICK = replace(
    compose().diagnose,
    input_hold="zoh",
    without=[name for name in catalogue() if name not in KEPT],
    always_fitted=["coulomb_friction"],
    families=2,
    places=1,
    starts=1,
    iterations=6,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A nominal arm, a log of it, and one of an arm that rubs at j2 and is damped at j1."""
    folder = tmp_path_factory.mktemp("arms")
    write_arm(folder / "arm.xml", 4)
    write_log(folder / "none.csv", record_arm(folder / "arm.xml", 12.0, seed=3))
    real = write_arm(folder / "real.xml", 4, friction=(0.0, 0.0, 0.5), damping=(0.0, 0.6))
    write_log(folder / "rubs.csv", record_arm(real, 12.0, seed=4))
    return folder


@pytest.fixture(scope="module")
def rubbing(folder: Path) -> Diagnosis:
    sim, real = str(folder / "arm.xml"), str(folder / "rubs.csv")
    return diagnose_files(sim, real, folder / "out", QUICK, command="lagsplat diagnose")


def test_every_fault_is_found_at_its_joint(rubbing: Diagnosis) -> None:
    rows = {row["joint"]: row for row in rubbing.checks["joints"]}
    found = {name: [effect["name"] for effect in row["effects"]] for name, row in rows.items()}
    assert found == {"j0": [], "j1": ["viscous_damping"], "j2": ["coulomb_friction"], "j3": []}
    assert {rows["j0"]["verdict"], rows["j3"]["verdict"]} == {"none"}
    assert rubbing.q_names[0] in ("j1", "j2")
    assert rubbing.candidates[0].coordinate == rubbing.q_names[0]


def test_lines_and_page_tell_of_all_joints(rubbing: Diagnosis, folder: Path) -> None:
    lines = "\n".join(write_lines(rubbing, report="report.html"))
    page = (folder / "out/report.html").read_text()
    for text in ("viscous damping at j1", "Coulomb friction at j2"):
        assert text in lines
        assert text in page
    assert "Joint by joint" in page
    assert "not fitted" in page  # a change of mass, which moves all joints
    stored = json.loads((folder / "out/diagnosis.json").read_text())
    assert [row["joint"] for row in stored["checks"]["joints"]] == ["j0", "j1", "j2", "j3"]
    assert stored["next_experiments"] is None


def test_the_patch_holds_what_was_found_at_both_joints(rubbing: Diagnosis, folder: Path) -> None:
    patched = mujoco.MjModel.from_xml_path(str(folder / "out/patched.xml"))
    assert patched.dof_frictionloss == pytest.approx([0.0, 0.0, 0.5, 0.0], abs=0.05)
    assert patched.dof_damping == pytest.approx([0.1, 0.7, 0.1, 0.1], abs=0.06)
    assert len(rubbing.checks["mujoco"]) == 2


def test_the_leading_joint_can_be_simulated_by_its_own_inputs(rubbing: Diagnosis, folder: Path) -> None:
    assert "alone" in rubbing.checks["augmented"][0]
    joint = load_augmented(folder / "out/augmented.safetensors")
    table = np.genfromtxt(folder / "out" / JOINT_INPUTS, delimiter=",", names=True)
    u = np.stack([table[f"u{i}"] for i in range(3)], axis=1)
    part = AppliedSignals(table["t"][:100], u[:100])
    real = read_trajectory_file(folder / "rubs.csv")
    measured = real.q[:100, int(rubbing.q_names[0][1])]
    rate = (measured[4] - measured[0]) / 0.04
    q, _ = simulate_augmented(joint, part, q=measured[:1], v=np.array([rate]))
    assert np.std(q[:, 0] - measured) < 0.2 * np.std(measured)


def test_an_arm_as_simulated_has_no_gap(folder: Path) -> None:
    sim, real = str(folder / "arm.xml"), str(folder / "none.csv")
    diagnosis = diagnose_files(sim, real, folder / "still", QUICK, command="")
    assert diagnosis.verdict == "none"
    assert [row["verdict"] for row in diagnosis.checks["joints"]] == ["none"] * 4
    assert not (folder / "still/patched.xml").exists()


def test_joints_stay_together_up_to_the_setting(folder: Path) -> None:
    few = replace(QUICK, max_coupled=4, joints=["j0"], actuators=["m0"])
    motion = read_trajectory_file(folder / "none.csv")
    alone = replace(motion, q=motion.q[:, :1], u=motion.u[:, :1], q_names=("q0",), u_names=("u0",))
    write_log(folder / "one.csv", alone)
    parts = open_inputs_by_joint(str(folder / "arm.xml"), str(folder / "one.csv"), few)
    assert [part.joint for part in parts] == [None]


def test_a_joint_without_a_torque_of_its_own_is_told(folder: Path) -> None:
    motors = [f'<motor name="m{i}" joint="j{i}"/>' for i in (0, 1)]
    write_arm(folder / "free.xml", 4, actuators=motors)
    motion = read_trajectory_file(folder / "none.csv")
    short = motion.pieces([(0, 200)])
    write_log(folder / "free.csv", replace(short, u=short.u[:, :2], u_names=("u0", "u1")))
    coupled = replace(QUICK, max_coupled=1, joints=["j0", "j3"], actuators=["m0", "m1"])
    two = replace(short, q=short.q[:, [0, 3]], u=short.u[:, :2], q_names=("q0", "q1"), u_names=("u0", "u1"))
    write_log(folder / "two.csv", two)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        parts = open_inputs_by_joint(str(folder / "free.xml"), str(folder / "two.csv"), coupled)
    assert any("no motor with a logged torque drives j3 alone" in str(each.message) for each in caught)
    assert parts[0].joint is None


def test_an_effect_leads_before_a_gap_without_a_name() -> None:
    def make(verdict: str, before: float) -> Diagnosis:
        gap = Gap(before, 0.1, 0.1, 0.01, 1.0, Interval(None, None, None))
        none = (Candidate("none", 1.0), Candidate("unknown", 0.0))
        return Diagnosis(verdict, none, (), gap, None, (), (), (), (), (), {})  # type: ignore[arg-type]

    order = [("effect", 0.9), ("effect", 0.2), ("unknown", 5.0), ("undetermined", 9.0), ("none", 9.0)]
    ranks = [rank_joint(make(*each)) for each in order]
    assert ranks == sorted(ranks)
