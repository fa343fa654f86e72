"""What a recording can tell apart: graded family by family, faster than a user can read."""

import time
from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.data_quality.noise import measure_noise
from lagsplat.diagnose.effects.excitation import Excitation, assess_excitation
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, multisine, swing

FAMILIES = """viscous_damping linear_stiffness mass_change constant_force input_gain cubic_stiffness
    coulomb_friction stribeck_friction load_dependent_friction quadratic_drag input_lag input_delay
    input_dead_zone input_saturation input_backlash hysteresis creep joint_backlash end_stop external_push
    external_periodic_force parameter_drift hidden_mode time_offset time_jitter frame_drops camera_change
    camera_drift exposure_blur payload armature controller_gain torque_speed_limit encoder_scale cogging
    position_dependent_damping asymmetric_friction parametric_stiffness circulatory_force base_motion"""


def rows(*motions: Trajectory, closed_loop: tuple[str, ...] = ()) -> dict[str, Excitation]:
    noise = measure_noise(motions, period_s=PERIOD_S)
    found = assess_excitation(motions, period_s=PERIOD_S, noise=noise, closed_loop=closed_loop)
    assert len({row.effect for row in found}) == len(found)
    return {row.effect: row for row in found}


def test_every_family_has_one_row_with_its_reason_and_its_remedy() -> None:
    for motion in (swing(), swing(drive=multisine(900)), swing(start=(1.0, 0.3, 0.2, 0.1))):
        found = rows(motion)
        assert set(found) == set(FAMILIES.split())
        for row in found.values():
            assert row.excited in ("yes", "weak", "no")
            assert row.reason
            assert bool(row.record) == (row.excited != "yes")


def test_a_free_decay_shows_dissipation_and_no_input() -> None:
    found = rows(swing(seconds=20.0, noise=0.003))
    for effect in (
        "viscous_damping",
        "coulomb_friction",
        "quadratic_drag",
        "cubic_stiffness",
        "joint_backlash",
    ):
        assert found[effect].excited == "yes", effect
    for effect in ("linear_stiffness", "mass_change"):
        assert found[effect].excited == "weak", effect
    for effect in (
        "input_gain",
        "input_lag",
        "input_delay",
        "input_dead_zone",
        "input_saturation",
        "time_offset",
    ):
        assert (found[effect].excited, found[effect].reason) == ("no", "no input is recorded")


def test_one_amplitude_cannot_tell_laws_of_amplitude_apart() -> None:
    found = rows(swing(damping=0.0, seconds=20.0))
    for effect in ("quadratic_drag", "cubic_stiffness", "joint_backlash"):
        assert found[effect].excited == "no", effect
    assert found["viscous_damping"].excited == "weak"


def test_inputs_are_judged_channel_by_channel() -> None:
    motion = swing(drive=multisine(1200), seconds=20.0)
    still = replace(motion, u=np.hstack([0.0 * motion.u, motion.u]), u_names=())
    found = rows(still)
    assert found["input_gain"].excited == "yes"
    assert found["input_gain"].inputs == ("u1",)
    assert found["linear_stiffness"].excited == "yes"
    constant = replace(motion, u=np.ones_like(motion.u))
    assert rows(constant)["input_lag"].reason == "all inputs are constant"


def test_dead_zone_needs_zero_and_saturation_needs_sizes() -> None:
    motion = swing(drive=multisine(1200), seconds=20.0)
    assert rows(motion)["input_dead_zone"].excited == "yes"
    assert rows(replace(motion, u=motion.u + 10.0))["input_dead_zone"].excited == "no"
    square = swing(drive=np.sign(np.sin(2.0 * np.pi * np.arange(1200) / 60.0 / 4.1)), seconds=20.0)
    assert rows(motion)["input_saturation"].excited == "yes"
    assert rows(square)["input_saturation"].excited == "no"


def test_a_closed_loop_and_a_slow_input_are_weak() -> None:
    motion = swing(drive=multisine(1200), seconds=20.0)
    assert rows(motion, closed_loop=("u0",))["input_delay"].excited == "weak"
    slow = np.sin(2.0 * np.pi * np.arange(1200) / 60.0 / 15.0)
    assert rows(swing(drive=slow, seconds=20.0))["input_lag"].excited == "no"


def test_noise_hides_what_happens_between_two_samples() -> None:
    assert rows(swing(noise=0.003))["frame_drops"].excited == "yes"
    assert rows(swing(noise=0.3))["frame_drops"].excited == "no"


def test_length_decides_about_slow_change() -> None:
    grades = [
        rows(swing(seconds=seconds, damping=0.001))["parameter_drift"].excited
        for seconds in (5.0, 15.0, 40.0)
    ]
    assert grades == ["no", "weak", "yes"]


def test_units_do_not_matter() -> None:
    motion = swing(drive=multisine(900), start=(1.0, 0.5))
    other = replace(motion, q=7.0 + 1e4 * motion.q[:, ::-1], u=1e-3 * motion.u, time_s=motion.time_s - 50.0)
    assert {k: r.excited for k, r in rows(motion).items()} == {k: r.excited for k, r in rows(other).items()}


@pytest.mark.parametrize("d", [1, 4])
def test_it_is_told_in_seconds(d: int) -> None:
    motion = swing(seconds=20.0, start=(1.0, 0.5, 0.3, 0.2)[:d], drive=multisine(1200))
    began = time.perf_counter()
    rows(motion)
    assert (
        time.perf_counter() - began < 10.0
    )  # usually a twentieth of a second; a loaded machine has its time
