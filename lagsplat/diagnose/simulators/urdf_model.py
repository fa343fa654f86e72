"""A simulator that is a URDF file, as MuJoCo's own reader takes it, with motors from its transmissions.

MuJoCo keeps inertias, damping, friction, ranges, limits of effort, and mimic joints as constraints. What a
URDF has beyond that, and what MuJoCo adds to it, are findings.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lagsplat.diagnose.core.result import Finding
from lagsplat.io.urdf import Urdf, UrdfTransmission, read_urdf

MOVING = ("revolute", "continuous", "prismatic")
TORQUE = ("", "effort", "effortjointinterface")  # command interfaces of a motor whose input is a force
TRANSLATED = "URDF as MuJoCo reads it"  # name of the findings


@dataclass(frozen=True)
class _Motor:
    name: str
    joint: str
    reduction: float


def load_urdf(path: Path, mujoco: Any) -> tuple[Any, tuple[Finding, ...]]:
    """The MuJoCo specification of a URDF file, with its motors, and what was lost or added on the way.

    ``mujoco`` is the module.

    Raises:
        FileNotFoundError, ValueError: as `read_urdf`, or MuJoCo refuses the robot.
    """
    urdf = read_urdf(path)
    try:
        spec = mujoco.MjSpec.from_string(urdf.text)
        spec.copy().compile()  # its errors name the element, and come before motors are added
    except ValueError as error:
        raise ValueError(f"{path}: MuJoCo cannot read it ({error}); {_suggest(str(error))}") from error
    motors, findings = _read_motors(path, urdf)
    for motor in motors:
        actuator = spec.add_actuator(name=motor.name)
        actuator.set_to_motor()
        actuator.trntype, actuator.target = mujoco.mjtTrn.mjTRN_JOINT, motor.joint
        actuator.gear = [motor.reduction, 0.0, 0.0, 0.0, 0.0, 0.0]
    return spec, (*_check_base(path, urdf), *_check_links(path, urdf), *_check_joints(path, urdf), *findings)


def _suggest(problem: str) -> str:
    if "A + B >= C" in problem:
        return (
            "an inertia that no body can have: correct it, or let MuJoCo do so by "
            '<mujoco><compiler balanceinertia="true"/></mujoco> in the file'
        )
    if "mass and inertia" in problem:
        return "give every link that moves an <inertial> with a mass"
    if "free joint" in problem:
        return "a floating joint may hang from the root link alone; make it fixed, or give an MJCF"
    if any(word in problem for word in ("mesh", "vertices", "STL", "OBJ")):
        return "replace the mesh by a whole one, or by a box or a cylinder"
    return "correct the file, or give an MJCF"


def _note(path: Path, what: str, why: str, remedy: str, *, level: str = "note") -> Finding:
    return Finding(level, TRANSLATED, path.name, what, why, remedy)


def _list_names(names: Sequence[str]) -> str:
    return ", ".join(names)


def _check_base(path: Path, urdf: Urdf) -> list[Finding]:
    floating = [joint.name for joint in urdf.joints if joint.type == "floating"]
    if floating:
        what = f"the base floats ({_list_names(floating)}), and is held where the file puts it"
        why = "coordinates are hinges and slides, so the base's motion and inertia are lost"
        remedy = "clamp the robot where it is recorded, or name a sim in Python"
        return [_note(path, what, why, remedy, level="warn")]
    if not urdf.root_has_mass:
        return []
    what = f"the link {urdf.root}, which has a mass, is fixed to the world"
    why = "a URDF does not say whether its root floats, and MuJoCo fixes it"
    return [_note(path, what, why, "add a link world with a floating joint to it where the robot is free")]


def _check_links(path: Path, urdf: Urdf) -> list[Finding]:
    findings = []
    if urdf.lost_meshes:
        files = [f"{lost.file} of link {lost.link}, which {lost.why}" for lost in urdf.lost_meshes]
        what = f"meshes for contacts are left out: {'; '.join(files)}"
        why = "masses and joints do not depend on them; contacts of these links are lost"
        remedy = "put them beside the file or into the package's folder, as STL or OBJ"
        findings.append(_note(path, what, why, remedy))
    if urdf.massless:
        what = f"links {_list_names(urdf.massless)} have no <inertial>"
        why = "MuJoCo gives them the mass of their contact geometry at the density of water, where they move"
        findings.append(_note(path, what, why, "write their <inertial>", level="warn"))
    return findings


def _check_joints(path: Path, urdf: Urdf) -> list[Finding]:
    findings = []
    types = {joint.name: joint.type for joint in urdf.joints}
    planar = [joint.name for joint in urdf.joints if joint.type == "planar"]
    if planar:
        parts = [f"{name}_{part}" for name in planar for part in ("TX", "TY", "RZ")]
        what = f"planar joints become two slides and a hinge each: {_list_names(parts)}"
        findings.append(_note(path, what, "MuJoCo has no planar joint", "name coordinates by these names"))
    mimics = [joint for joint in urdf.joints if joint.mimics is not None]
    kept = [each.name for each in mimics if {each.type, types.get(each.mimics or "", "")} <= set(MOVING)]
    lost = [each.name for each in mimics if each.name not in kept]
    if kept:
        what = f"joints {_list_names(kept)} follow others (<mimic>) exactly, and are no coordinates"
        why = "their masses move with the joint that they follow"
        findings.append(_note(path, what, why, "name one with diagnose.joints to take it as free"))
    if lost:
        what = f"<mimic> of {_list_names(lost)} is lost"
        why = "a joint can follow a hinge or a slide alone"
        findings.append(_note(path, what, why, "correct the joint that it names", level="warn"))
    unused = [f"<{name}>" for name in urdf.ignored]
    if any(joint.velocity_limit for joint in urdf.joints):
        unused.append("limits of velocity")
    if unused:
        what = f"{_list_names(unused)} have no counterpart in MuJoCo and are left out"
        why = (
            "friction and damping that only Gazebo knows are lost with them"
            if "<gazebo>" in unused
            else ("a motion that reaches them is not the sim's")
        )
        findings.append(_note(path, what, why, "write damping and friction into <dynamics>"))
    return findings


def _read_motors(path: Path, urdf: Urdf) -> tuple[list[_Motor], list[Finding]]:
    """One motor for each simple transmission, or for each effort interface of `ros2_control` without one."""
    findings, motors = [], list[_Motor]()
    moving = [joint.name for joint in urdf.joints if joint.type in MOVING]
    for each in urdf.transmissions:
        wrong = [name for name in each.joints if name not in moving]
        if each.is_simple and not wrong:
            motors.append(_Motor(_choose_name(each, motors), each.joints[0], each.reduction))
            if each.interface not in TORQUE:
                what = (
                    f"transmission {each.name} takes {each.interface} commands, and the sim's motor a torque"
                )
                why = "the controller in between is not in the file"
                remedy = "log the motor's torque as its input"
                findings.append(_note(path, what, why, remedy, level="warn"))
            continue
        reason = f"names {_list_names(wrong)}, no moving joint" if wrong else f"is a {each.type or 'chain'}"
        what = f"transmission {each.name} {reason}, and has no motor in the sim"
        why = "a motor that drives several joints, or none, is not read"
        remedy = "give an MJCF with this actuator"
        findings.append(_note(path, what, why, remedy, level="warn"))
    driven = {motor.joint for motor in motors}
    motors += [
        _Motor(name, name, 1.0) for name in urdf.effort_joints if name in moving and name not in driven
    ]
    geared = [f"{each.name} ({each.reduction:g} at {each.joint})" for each in motors if each.reduction != 1.0]
    if geared:
        what = f"motors act through their mechanicalReduction: {_list_names(geared)}"
        why = "an input is the torque of the motor, and the joint gets so many times as much"
        findings.append(_note(path, what, why, "write 1 where the log holds torques of the joint"))
    driven = {motor.joint for motor in motors}
    following = {joint.name for joint in urdf.joints if joint.mimics is not None}
    idle = [name for name in moving if name not in driven and name not in following]
    if idle:
        what = f"no <transmission> drives joints {_list_names(idle)}, so they have no motor in the sim"
        why = "a logged torque needs a motor to act through"
        remedy = "add a SimpleTransmission for each motor, with the reduction 1 for torques of the joint"
        findings.append(_note(path, what, why, remedy))
    return motors, findings


def _choose_name(transmission: UrdfTransmission, taken: Sequence[_Motor]) -> str:
    names = [*transmission.actuators, transmission.name, transmission.joints[0]]
    used = {motor.name for motor in taken}
    free = [name for name in names if name and name not in used]
    return free[0] if free else f"{transmission.joints[0]}_motor{len(taken)}"
