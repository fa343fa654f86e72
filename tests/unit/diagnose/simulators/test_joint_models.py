"""A chain as one model for each joint: exact along the true motion, with inputs that nobody logged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.inference.placement import place_effects
from lagsplat.diagnose.inference.problem import build_problem
from lagsplat.diagnose.residual.latent_force import smooth_motions
from lagsplat.diagnose.simulators.joint_models import (
    JointModel,
    average_held,
    build_joint_models,
    compute_input_rate,
    find_motors,
)
from lagsplat.io.mujoco.model import load_mujoco
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.arms import NOISE, record_arm, write_arm

pytest.importorskip("mujoco")
SETTINGS = replace(compose().diagnose, input_hold="zoh")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_arm(tmp_path_factory.mktemp("arm") / "arm.xml", 4)


@pytest.fixture(scope="module")
def motion(path: Path) -> Trajectory:
    return record_arm(path, 12.0, seed=5)


@pytest.fixture(scope="module")
def joints(path: Path, motion: Trajectory) -> tuple[JointModel, ...]:
    chosen = load_mujoco(path)
    return build_joint_models(path, chosen, find_motors(chosen, motion.q), [motion], hold="zoh")


def test_every_joint_follows_its_own_recording(joints: tuple[JointModel, ...]) -> None:
    assert [joint.joint for joint in joints] == ["j0", "j1", "j2", "j3"]
    for joint in joints:
        for motions in (joint.motions, joint.nominal):
            problem = build_problem(joint.sim, motions, SETTINGS)
            fit = problem.fit((), np.zeros(problem.rollout_model.nuisance.size))
            assert fit.misfit / problem.degrees_of_freedom < 3.0
            assert problem.windows.longest * problem.dataset.dt_s > 1.0  # seconds, of an upright arm


def test_a_joint_keeps_its_own_damper_and_the_gear_of_its_motor(joints: tuple[JointModel, ...]) -> None:
    for i, joint in enumerate(joints):
        model = joint.sim.model
        assert model.damping.ravel() * joint.inertia == pytest.approx([0.1], rel=1e-4)
        assert model.input_map[0, :, 0] * joint.inertia == pytest.approx([1.0 + i, 1.0, 0.0], abs=1e-6)


def test_no_effect_acts_on_what_was_computed(joints: tuple[JointModel, ...]) -> None:
    joint = joints[1]
    assert joint.motions[0].computed == ("coupling of j1", "rate of m1")
    problem = build_problem(joint.sim, joint.motions, SETTINGS)
    names = {"q_names": ("j1",), "u_names": joint.motions[0].u_names}
    hints = ()
    kept = [name for name, effect in catalogue().items() if isinstance(effect, InputEffect)]
    without = [name for name in catalogue() if name not in kept]
    placed = place_effects(
        problem.rollout_model, hints, **names, without=without, computed=joint.motions[0].computed
    )
    assert {place.effect.name for place in placed} > {"input_gain", "input_dead_zone", "time_offset"}
    assert {channel for place in placed for channel in place.list_channels(3)} == {0}
    logged = problem.rollout_model.logged
    for place in placed:
        theta = place.to_physical(np.full((1, place.size), 0.5))
        changed, _ = problem.rollout_model._inputs([(place, theta)], 1)
        assert np.array_equal(changed[..., 1:], logged[..., 1:])
        assert not np.array_equal(changed[..., 0], logged[..., 0])


def test_effects_that_need_the_whole_mechanism_are_not_placed(joints: tuple[JointModel, ...]) -> None:
    problem = build_problem(joints[0].sim, joints[0].motions, SETTINGS)
    shared = {name for name, effect in catalogue().items() if effect.needs_all_forces}
    assert {"mass_change", "payload", "encoder_scale"} <= shared
    without = [name for name in catalogue() if name not in {*shared, "coulomb_friction"}]
    u_names = joints[0].motions[0].u_names
    both = [
        place_effects(
            problem.rollout_model, (), q_names=("j0",), u_names=u_names, without=without, computed=computed
        )
        for computed in ((), u_names[1:])
    ]
    assert {place.effect.name for place in both[0]} == {*shared, "coulomb_friction"}
    assert {place.effect.name for place in both[1]} == {"coulomb_friction"}


def test_motors_of_position_and_of_two_joints_are_none(tmp_path: Path) -> None:
    servo = '<position name="m1" joint="j1" kp="5"/>'
    shared = '<motor name="m2" tendon="both"/>'
    motors = ['<motor name="m0" joint="j0"/>', servo, '<motor name="m3" joint="j2"/>']
    path = write_arm(tmp_path / "arm.xml", 4, actuators=motors)
    chosen = load_mujoco(path)
    found = find_motors(chosen, np.zeros((3, 4)))
    assert {joint: motor.channel for joint, motor in found.items()} == {0: 0, 2: 2}
    tendon = (
        '<tendon><fixed name="both"><joint joint="j1" coef="1"/><joint joint="j2" coef="1"/></fixed></tendon>'
    )
    text = path.read_text().replace("<actuator>", f"{tendon}<actuator>{shared}")
    path.write_text(text)
    assert set(find_motors(load_mujoco(path), np.zeros((3, 4)))) == {0}


def test_a_held_input_acts_by_its_mean_and_rates_end_with_their_clip() -> None:
    time_s = np.arange(6.0)
    motion = Trajectory(time_s, np.zeros((6, 1)), np.zeros((6, 0)), segments=((0, 3), (3, 6)))
    values = np.array([0.0, 2.0, 4.0, 10.0, 11.0, 13.0])
    assert average_held(values, motion).tolist() == [1.0, 3.0, 4.0, 10.5, 12.0, 13.0]
    assert compute_input_rate(values, motion, hold="zoh").tolist() == [2.0, 2.0, 0.0, 1.0, 2.0, 0.0]
    assert compute_input_rate(values, motion, hold="linear").tolist() == [2.0, 2.0, 2.0, 1.0, 1.5, 2.0]


def test_smoothing_removes_noise_and_keeps_accelerations() -> None:
    time_s, rng = np.arange(800) / 100, np.random.default_rng(0)
    rate = 2.0 * np.pi * 0.7
    q = np.stack([np.sin(rate * time_s), np.full(800, 0.3)], axis=1)
    noisy = q + [NOISE, 0.0] * rng.standard_normal((800, 2))
    motion = Trajectory(time_s, noisy, np.zeros((800, 0)))
    smooth = smooth_motions([motion], periods_s=[1.0 / 0.7, 1.0])[0]
    assert np.std(smooth.q[:, 0] - q[:, 0]) < 0.5 * NOISE
    assert np.std(smooth.a[50:-50, 0] + rate**2 * q[50:-50, 0]) < 0.02 * rate**2
    assert np.array_equal(smooth.q[:, 1], q[:, 1])
    assert not smooth.a[:, 1].any()
