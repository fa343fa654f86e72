"""The MuJoCo specification of a URDF file, as MuJoCo's own reader makes it, with motors from transmissions.

MuJoCo keeps inertias, damping, friction, ranges, limits of effort, and mimic joints as constraints. Remarks
tell what a URDF has beyond that, and what MuJoCo adds to it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lagsplat.io.mujoco.package import require_mujoco
from lagsplat.io.urdf import Urdf, UrdfTransmission, read_urdf

MOVING = ("revolute", "continuous", "prismatic")
TORQUE = ("", "effort", "effortjointinterface")  # command interfaces of a motor whose input is a force
UrdfMotor = tuple[str, str, float]  # its name, its joint, and how many times as fast as the joint it turns


@dataclass(frozen=True)
class UrdfRemark:
    """What of a URDF was lost or added, why it matters, and the remedy, as sentences without a full stop."""

    what: str
    why: str
    remedy: str
    level: str = "note"  # or "warn", where the simulator may be wrong by it


def load_urdf(path: Path) -> tuple[Any, tuple[UrdfRemark, ...]]:
    """The MuJoCo specification of a URDF file, with its motors, and what was lost or added on the way.

    Raises:
        FileNotFoundError, ValueError: as `read_urdf`, or MuJoCo refuses the robot or is not installed.
    """
    urdf, mujoco = read_urdf(path), require_mujoco()
    try:
        spec = mujoco.MjSpec.from_string(urdf.text)
        spec.copy().compile()  # its errors name the element, and come before motors are added
    except ValueError as error:
        raise ValueError(f"{path}: MuJoCo cannot read it ({error}); {_suggest(str(error))}") from error
    motors, remarks = _read_motors(urdf)
    for name, joint, reduction in motors:
        actuator = spec.add_actuator(name=name)
        actuator.set_to_motor()
        actuator.trntype, actuator.target = mujoco.mjtTrn.mjTRN_JOINT, joint
        actuator.gear = [reduction, 0.0, 0.0, 0.0, 0.0, 0.0]
    return spec, (*_check_base(urdf), *_check_links(urdf), *_check_joints(urdf), *remarks)


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


def _check_base(urdf: Urdf) -> Iterator[UrdfRemark]:
    floating = [joint.name for joint in urdf.joints if joint.type == "floating"]
    if floating:
        yield UrdfRemark(
            f"the base floats ({', '.join(floating)}), and is held where the file puts it",
            "coordinates are hinges and slides, so the base's motion and inertia are lost",
            "clamp the robot where it is recorded, or name a sim in Python",
            "warn",
        )
    elif urdf.root_has_mass:
        yield UrdfRemark(
            f"the link {urdf.root}, which has a mass, is fixed to the world",
            "a URDF does not say whether its root floats, and MuJoCo fixes it",
            "add a link world with a floating joint to it where the robot is free",
        )


def _check_links(urdf: Urdf) -> Iterator[UrdfRemark]:
    if urdf.lost_meshes:
        yield UrdfRemark(
            f"meshes for contacts are left out: {'; '.join(urdf.lost_meshes)}",
            "masses and joints do not depend on them; contacts of these links are lost",
            "put them beside the file or into the package's folder, as STL or OBJ",
        )
    if urdf.massless:
        yield UrdfRemark(
            f"links {', '.join(urdf.massless)} have no <inertial>",
            "MuJoCo gives them the mass of their contact geometry at the density of water, where they move",
            "write their <inertial>",
            "warn",
        )


def _check_joints(urdf: Urdf) -> Iterator[UrdfRemark]:
    types = {joint.name: joint.type for joint in urdf.joints}
    planar = [f"{name}_{part}" for name in types if types[name] == "planar" for part in ("TX", "TY", "RZ")]
    if planar:
        yield UrdfRemark(
            f"planar joints become two slides and a hinge each: {', '.join(planar)}",
            "MuJoCo has no planar joint",
            "name coordinates by these names",
        )
    mimics = [joint for joint in urdf.joints if joint.mimics is not None]
    kept = [each.name for each in mimics if {each.type, types.get(each.mimics or "", "")} <= set(MOVING)]
    lost = [each.name for each in mimics if each.name not in kept]
    if kept:
        yield UrdfRemark(
            f"joints {', '.join(kept)} follow others (<mimic>) exactly, and are no coordinates",
            "their masses move with the joint that they follow",
            "name one with diagnose.joints to take it as free",
        )
    if lost:
        yield UrdfRemark(
            f"<mimic> of {', '.join(lost)} is lost",
            "a joint can follow a hinge or a slide alone",
            "correct the joint that it names",
            "warn",
        )
    unused = [f"<{name}>" for name in urdf.ignored]
    if any(joint.velocity_limit for joint in urdf.joints):
        unused.append("limits of velocity")
    if unused:
        yield UrdfRemark(
            f"{', '.join(unused)} have no counterpart in MuJoCo and are left out",
            "friction and damping that only Gazebo knows are lost with them"
            if "<gazebo>" in unused
            else "a motion that reaches them is not the sim's",
            "write damping and friction into <dynamics>",
        )


def _read_motors(urdf: Urdf) -> tuple[list[UrdfMotor], list[UrdfRemark]]:
    """One motor for each simple transmission, or for each effort interface of `ros2_control` without one."""
    remarks, motors = list[UrdfRemark](), list[UrdfMotor]()
    moving = [joint.name for joint in urdf.joints if joint.type in MOVING]
    for each in urdf.transmissions:
        wrong = [name for name in each.joints if name not in moving]
        if wrong or not each.is_simple:
            reason = f"names {', '.join(wrong)}, no moving joint" if wrong else f"is a {each.type or 'chain'}"
            what = f"transmission {each.name} {reason}, and has no motor in the sim"
            why = "a motor that drives several joints, or none, is not read"
            remarks.append(UrdfRemark(what, why, "give an MJCF with this actuator", "warn"))
            continue
        motors.append((_choose_name(each, motors), each.joints[0], each.reduction))
        if each.interface not in TORQUE:
            what = f"transmission {each.name} takes {each.interface} commands, and the sim's motor a torque"
            why = "the controller in between is not in the file"
            remarks.append(UrdfRemark(what, why, "log the motor's torque as its input", "warn"))
    driven = {joint for _, joint, _ in motors}
    motors += [(name, name, 1.0) for name in urdf.effort_joints if name in moving and name not in driven]
    geared = [f"{name} ({gear:g} at {joint})" for name, joint, gear in motors if gear != 1.0]
    if geared:
        what = f"motors act through their mechanicalReduction: {', '.join(geared)}"
        why = "an input is the torque of the motor, and the joint gets so many times as much"
        remarks.append(UrdfRemark(what, why, "write 1 where the log holds torques of the joint"))
    needless = {joint for _, joint, _ in motors}
    needless |= {joint.name for joint in urdf.joints if joint.mimics is not None}
    idle = [name for name in moving if name not in needless]
    if idle:
        what = f"no <transmission> drives joints {', '.join(idle)}, so they have no motor in the sim"
        why = "a logged torque needs a motor to act through"
        remedy = "add a SimpleTransmission for each motor, with the reduction 1 for torques of the joint"
        remarks.append(UrdfRemark(what, why, remedy))
    return motors, remarks


def _choose_name(transmission: UrdfTransmission, taken: Sequence[UrdfMotor]) -> str:
    joint, used = transmission.joints[0], {name for name, *_ in taken}
    names = (*transmission.actuators, transmission.name, joint)
    return next((name for name in names if name and name not in used), f"{joint}_motor{len(taken)}")
