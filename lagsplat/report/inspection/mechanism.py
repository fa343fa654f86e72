"""What a MuJoCo file or a URDF holds as a simulator, in words, and the command that uses it."""

import shlex
from pathlib import Path

from lagsplat.diagnose.simulators.mujoco_model import check_urdf
from lagsplat.io.mujoco.model import MujocoSelection, load_mujoco
from lagsplat.io.mujoco.package import require_mujoco


def describe_mechanism(path: Path) -> str:
    """Describe joints and actuators, what a URDF loses in MuJoCo, and the columns that a log needs.

    Raises:
        FileNotFoundError, ValueError: as `lagsplat.io.mujoco.model.load_mujoco`.
    """
    chosen = load_mujoco(path)
    lines = [f"source     {path.name}, {chosen.model.nbody - 1} bodies"]
    lines += [f"joint      q{i}: {_describe_joint(chosen, i)}" for i in range(len(chosen.joints))]
    lines += [f"actuator   u{i}: {name}" for i, name in enumerate(chosen.actuators)]
    lines += [] if chosen.actuators else ["actuator   none: the mechanism moves freely"]
    if chosen.followers:
        lines.append(f"tied       {len(chosen.followers)} more joint(s) follow these by an equality")
    lines += [f"{finding.level:<10} {finding.what}; {finding.remedy}" for finding in check_urdf(path)]
    words = ["lagsplat", "diagnose", f"sim={path}", "real=LOG"]
    counted = (("q", len(chosen.joints)), ("u", len(chosen.actuators)))
    columns = ", ".join(["t", *(f"{letter}{i}" for letter, n in counted for i in range(n))])
    return "\n".join([*lines, f"to use it  {shlex.join(words)}", f"           LOG has columns {columns}"])


def _describe_joint(chosen: MujocoSelection, i: int) -> str:
    """Kind, range, damping, dry friction and rotor inertia of coordinate ``i``, where there are any."""
    model, at = chosen.model, int(chosen.at_v[i])
    joint = int(model.dof_jntid[at])
    slides = model.jnt_type[joint] == int(require_mujoco().mjtJoint.mjJNT_SLIDE)
    unit, torque = ("m", "N") if slides else ("rad", "N m")
    told = [f"{chosen.joints[i]}, a {'slide' if slides else 'hinge'}"]
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint]
        told.append(f"{low:.4g} to {high:.4g} {unit}")
    for name, value, of in (
        ("damping", float(model.dof_damping[at].reshape(-1)[0]), "N s/m" if slides else "N m s/rad"),
        ("dry friction", float(model.dof_frictionloss[at]), torque),
        ("inertia of the rotor", float(model.dof_armature[at]), "kg" if slides else "kg m^2"),
    ):
        told += [f"{name} {value:.4g} {of}"] if value else []
    return ", ".join(told)
