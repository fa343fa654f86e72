"""MuJoCo models as sims: what MuJoCo itself simulates against the sampled model, and patched files."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.augmented.mujoco_export import patch_augmented
from lagsplat.diagnose.augmented.simulate import AppliedSignals, simulate_augmented
from lagsplat.diagnose.effects.base import Direction, InputEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import PRESLIDING, LogNormal, Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.simulators.mujoco_model import project_mujoco
from lagsplat.io.mujoco.model import find_position_targets, load_mujoco
from tests.unit.diagnose.toys import bare

mujoco = pytest.importorskip("mujoco")

ARM = """
<mujoco>
  <option timestep="0.001" integrator="RK4" gravity="0 0 -9.81"><flag contact="disable"/></option>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.05" armature="0.01" stiffness="0.4"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.6"/>
      {fore}
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="shoulder" gear="0.8"/>
    {servo}
  </actuator>
</mujoco>
"""
FORE = """<body pos="0 0 -0.4"><joint name="elbow" type="hinge" axis="0 1 0" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.4"/></body>"""
SERVO = '<position name="hold" joint="elbow" kp="2" kv="0.05"/>'
SCALES = Scales(coordinate=0.5, velocity=3.0, reach=1.0, frame_s=0.01, duration_s=4.0, stiffness=36.0)


def arm(folder: Path, d: int) -> Path:
    path = folder / f"arm{d}.xml"
    path.write_text(ARM.format(fore=FORE if d == 2 else "", servo=SERVO if d == 2 else ""))
    return path


def region(d: int, n_u: int) -> OperatingRegion:
    rng = np.random.default_rng(0)
    return OperatingRegion(
        *(s * rng.uniform(-1.0, 1.0, (500, k)) for s, k in ((0.9, d), (5.0, d), (1.0, n_u)))
    )


def drive(n_u: int) -> AppliedSignals:
    time = np.arange(400) * 0.005
    return AppliedSignals(time, 0.8 * np.sin(np.outer(time, 5.0 * np.arange(1.0, n_u + 1.0))))


def simulated(path: Path, by: AppliedSignals, q: np.ndarray) -> np.ndarray:
    """MuJoCo's own rollout; inputs are interpolated at the middle of its steps."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data, out = mujoco.MjData(model), [q]
    data.qpos[:] = q
    begin = np.array([np.interp(0.0, by.time_s, column) for column in by.u.T])
    data.act[:] = begin[: model.na]
    while len(out) < len(by.time_s):
        data.ctrl[:] = [np.interp(data.time + 0.5 * model.opt.timestep, by.time_s, c) for c in by.u.T]
        mujoco.mj_step(model, data)
        if data.time > by.time_s[len(out)] - 1e-6:
            out.append(data.qpos.copy())
    return np.array(out)


def kept(model: MechanicalModel, d: int, n_u: int) -> AugmentedSimulator:
    return bare(model, region(d, n_u), step_s=0.001, dt_s=0.005)


@pytest.mark.parametrize("d", [1, 2])
def test_a_model_file_moves_as_mujoco_moves_it(tmp_path: Path, d: int) -> None:
    path = arm(tmp_path, d)
    found = project_mujoco(path, load_mujoco(path), region(d, d))
    assert found.error < 0.003
    start = np.array([0.6, -0.4])[:d]
    ours, _ = simulate_augmented(kept(found.model, d, d), drive(d), q=start)
    theirs = simulated(path, drive(d), start)
    assert np.abs(ours - theirs).max() < 0.01 * np.ptp(theirs)


def test_joints_and_actuators_can_be_chosen(tmp_path: Path) -> None:
    path = arm(tmp_path, 2)
    chosen = load_mujoco(path, joints=["elbow"], actuators=["hold"])
    assert (chosen.joints, chosen.actuators) == (("elbow",), ("hold",))
    model = project_mujoco(path, load_mujoco(path, joints=["elbow"], actuators=["hold"]), region(1, 1)).model
    # the forearm alone: gravity and the servo's stiffness over the inertia of a rod about its end
    data = mujoco.MjData(chosen.model)
    mujoco.mj_forward(chosen.model, data)
    full = np.zeros((2, 2))
    mujoco.mj_fullM(chosen.model, data, full)
    push = model.acceleration(np.zeros((1, 1)), np.zeros((1, 1)), np.ones((1, 1)))
    assert push[0, 0] == pytest.approx(2.0 / full[1, 1], rel=1e-3)
    with pytest.raises(ValueError, match=r"no joint 'wrist', only \['shoulder', 'elbow'\]"):
        load_mujoco(path, joints=["wrist"])
    with pytest.raises(ValueError, match=r"2 joints .* 1 column\(s\) q"):
        project_mujoco(path, load_mujoco(path), region(1, 2))


def test_what_is_no_model_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_mujoco(tmp_path / "gone.xml")
    (tmp_path / "bad.xml").write_text("<mujoco><nonsense/></mujoco>")
    with pytest.raises(ValueError, match="MuJoCo cannot read it"):
        load_mujoco(tmp_path / "bad.xml")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ValueError, match=r"pip install 'lagsplat\[mujoco\]'"):
        load_mujoco(arm(tmp_path, 1))


def added(
    one: AugmentedSimulator, name: str, values: dict[str, float], variant: str = "", at: int | None = 0
) -> AugmentedSimulator:
    """The sim with one effect of given parameters, on a joint or input, or on all joints."""
    effect, model = catalogue()[name], one.model
    on_input = isinstance(effect, InputEffect)
    along = None
    if at is not None and not on_input:
        along = Direction(f"q{at}", np.eye(model.d)[at], float(model.inertia[at, at]), float(model.rest[at]))
    place = PlacedEffect(effect, SCALES, variant, along, at if on_input else None)
    x = []
    for p in effect.parameters:
        value = values.get(p.name, p.grid[0] if p in PRESLIDING else 0.0)
        if p.kind == "log_ratio":
            x.append(np.log(value))
        elif isinstance(p.prior, LogNormal):
            x.append(p.prior.unknown(value / SCALES.of(p.kind)))
        else:
            x.append(value / SCALES.of(p.kind))
    return replace(one, effects=(place,), x=np.concatenate([x, one.x]))


CASES = [
    ("viscous_damping", {"rate": 1.5}, "", 0.01),
    ("quadratic_drag", {"coefficient": 0.5}, "", 0.01),
    ("coulomb_friction", {"acceleration": 3.0}, "", 0.03),
    ("constant_force", {"acceleration": 6.0}, "", 0.01),
    ("cubic_stiffness", {"coefficient": 30.0}, "", 0.01),
    ("linear_stiffness", {"ratio": 1.3}, "", 0.01),
    ("linear_stiffness", {"ratio": 1.3}, "spring", 0.01),
    ("mass_change", {"ratio": 1.4}, "", 0.01),
    ("armature", {"ratio": 0.4}, "", 0.01),
    ("input_gain", {"ratio": 0.7}, "", 0.01),
    ("input_lag", {"time_constant": 0.15}, "", 0.01),
    ("input_delay", {"delay": 0.1}, "", 0.02),
    ("input_saturation", {"limit": 0.3, "sharpness": 300.0}, "", 0.01),
    ("end_stop", {"stiffness_ratio": 20.0, "position": 0.3}, "upper", 0.03),
]


@pytest.mark.parametrize(
    ("name", "values", "variant", "bound"), CASES, ids=[" ".join((case[0], case[2])) for case in CASES]
)
def test_a_patched_file_moves_as_the_augmented_sim(
    tmp_path: Path, name: str, values: dict[str, float], variant: str, bound: float
) -> None:
    path, out = arm(tmp_path, 1), tmp_path / "patched" / "arm.xml"
    one = kept(project_mujoco(path, load_mujoco(path), region(1, 1)).model, 1, 1)
    changed = added(one, name, values, variant)
    assert patch_augmented(path, out, changed)
    start = np.array([0.6])
    ours, _ = simulate_augmented(changed, drive(1), q=start)
    before, theirs = simulated(path, drive(1), start), simulated(out, drive(1), start)
    size = np.ptp(before)
    assert np.abs(theirs - before).max() > 0.05 * size
    assert np.abs(ours - theirs).max() < bound * size


def test_every_counterpart_is_tried() -> None:
    assert {case[0] for case in CASES} | {"controller_gain"} == {
        name for name, effect in catalogue().items() if callable(effect.mujoco)
    }


def test_gains_of_a_controller_are_those_of_its_position_actuator(tmp_path: Path) -> None:
    path, out = arm(tmp_path, 1), tmp_path / "out.xml"
    servo = '<position name="hold" joint="shoulder" kp="3" kv="0.1"/>'
    path.write_text(path.read_text().replace('<motor name="drive" joint="shoulder" gear="0.8"/>', servo))
    chosen = load_mujoco(path)
    assert find_position_targets(chosen) == [(0, 0)]
    model = project_mujoco(path, load_mujoco(path), region(1, 1)).model
    gain = float(model.drive(np.zeros((1, 1)), np.ones((1, 1)))[0, 0] / model.inertia[0, 0])
    one = added(kept(model, 1, 1), "controller_gain", {"kp_ratio": 1.5, "kd": 0.8})
    servo_place = replace(one.effects[0], channel=0, constants=(gain, float(model.rest[0])))
    changed = replace(one, effects=(servo_place,))
    (change,) = patch_augmented(path, out, changed)
    assert change.startswith("actuator hold: kp 4.5, kv ")
    start = np.array([0.6])
    ours, _ = simulate_augmented(changed, drive(1), q=start)
    before, theirs = simulated(path, drive(1), start), simulated(out, drive(1), start)
    assert np.abs(theirs - before).max() > 0.05 * np.ptp(before)
    assert np.abs(ours - theirs).max() < 0.01 * np.ptp(before)


def test_motors_and_geared_actuators_have_no_target_of_their_own(tmp_path: Path) -> None:
    assert find_position_targets(load_mujoco(arm(tmp_path, 2))) == [(1, 1)]
    geared = tmp_path / "geared.xml"
    geared.write_text(arm(tmp_path, 2).read_text().replace('kp="2"', 'kp="2" gear="3"'))
    assert find_position_targets(load_mujoco(geared)) == []


def test_an_effect_is_written_at_its_joint_or_not_at_all(tmp_path: Path) -> None:
    path, out = arm(tmp_path, 2), tmp_path / "out.xml"
    plain = kept(project_mujoco(path, load_mujoco(path), region(2, 2)).model, 2, 2)
    (change,) = patch_augmented(path, out, added(plain, "viscous_damping", {"rate": 2.0}, at=1))
    assert change.startswith("joint elbow: damping")
    chosen, new = load_mujoco(path), mujoco.MjModel.from_xml_path(str(out))
    data, full = mujoco.MjData(chosen.model), np.zeros((2, 2))
    mujoco.mj_forward(chosen.model, data)
    mujoco.mj_fullM(chosen.model, data, full)
    np.testing.assert_allclose(new.dof_damping, [0.05, 0.02 + 2.0 * full[1, 1]], rtol=1e-5)
    out.unlink()
    creep = added(plain, "creep", {"stiffness_ratio": 0.2, "time_constant": 0.3}, at=1)
    feeding = added(plain, "viscous_damping", {"rate": -50.0}, at=1)
    everywhere = [
        added(plain, name, {"acceleration": 1.0}, at=None) for name in ("coulomb_friction", "constant_force")
    ]
    for simulator in (creep, feeding, *everywhere):
        assert patch_augmented(path, out, simulator) == ()
        assert not out.exists()


def test_a_heavier_whole_keeps_its_free_motion(tmp_path: Path) -> None:
    path, out = arm(tmp_path, 2), tmp_path / "out.xml"
    plain = kept(project_mujoco(path, load_mujoco(path), region(2, 2)).model, 2, 2)
    assert patch_augmented(path, out, added(plain, "mass_change", {"ratio": 1.5}, at=None))
    old, new = (mujoco.MjModel.from_xml_path(str(p)) for p in (path, out))
    masses, forces = [], []
    for model in (old, new):
        data, full = mujoco.MjData(model), np.zeros((2, 2))
        data.qpos[:] = [0.4, -0.7]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        masses.append(full)
        forces.append(data.qfrc_bias - data.qfrc_passive)
    np.testing.assert_allclose(masses[1], 1.5 * masses[0], rtol=1e-5)
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-5)
