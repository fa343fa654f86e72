"""Units of joints in a LeRobot dataset, which its files do not tell, by a stated rule or the user's setting.

The rule, in order:

1. The setting ``joint_unit``.
2. LeRobot's first types of robot (`DEGREE_ROBOTS`) write degrees.
3. Its later types (`SCALED_ROBOTS`) write degrees, or per cent of each joint's range from -100 to 100, as
   their owner chose. Only degrees exceed 100; where nothing does, the user must say.
4. Other robots: radians if no state exceeds a turn; otherwise the user must say.

Degrees become radians. A gripper, from 0 to 100 of its range, and whatever is no angle is kept as written.

Source: LeRobot 0.3.3 and 0.4.4, ``MotorsBus._normalize``; before, ``apply_calibration`` of its motors.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from lagsplat.io.config import JOINT_UNITS
from lagsplat.io.lerobot.dataset import LerobotDataset

DEGREE_ROBOTS = ("so100", "so101", "koch", "koch_bimanual", "moss")
SCALED_ROBOTS = (
    "so100_follower",
    "so101_follower",
    "so_follower",
    "bi_so100_follower",
    "bi_so_follower",
    "koch_follower",
    "omx_follower",
    "lekiwi",
    "lekiwi_client",
)
FULL_SCALE, SLACK = 100.0, 0.5  # of a joint's range in per cent; rounding of a bounded value
ONE_TURN = 2.0 * np.pi
STATE, ACTION = "observation.state", "action"


@dataclass(frozen=True)
class JointUnit:
    """One of `JOINT_UNITS`, or empty where the user must say, and why."""

    name: str
    reason: str

    @property
    def factor(self) -> float:
        """What an angle is multiplied by."""
        return np.pi / 180.0 if self.name == "degree" else 1.0

    def unit_of(self, column: str) -> str:
        """The unit of a column as it is read."""
        if is_gripper(column):
            return "as written"
        if not is_joint(column):
            return "unknown"
        return {"degree": "rad", "radian": "rad"}.get(self.name, "as written")


def is_gripper(column: str) -> bool:
    """Whether a column is a gripper's opening."""
    return is_joint(column) and "gripper" in column.lower()


def is_joint(column: str) -> bool:
    """Whether a column is the position of a joint, or its target."""
    rates = (".vel", ".velocity", ".torque", ".effort", ".eff", ".current")
    return column.startswith((STATE, ACTION)) and not column.lower().endswith(rates)


def decide_unit(
    dataset: LerobotDataset, states: Mapping[str, np.ndarray], *, setting: str | None
) -> JointUnit:
    """The unit of the joints, of which ``states`` gives the positions by column."""
    if setting is not None:
        return JointUnit(setting, f"joint_unit={setting} says so")
    robot = dataset.robot
    angles = [np.abs(values) for name, values in states.items() if not is_gripper(name)]
    largest = max((float(np.nanmax(each)) for each in angles if np.isfinite(each).any()), default=0.0)
    if robot in DEGREE_ROBOTS:
        return JointUnit("degree", f"robots of type {robot} write degrees")
    if robot in SCALED_ROBOTS:
        modes = f"robots of type {robot} write degrees, or per cent of a joint's range from -100 to 100"
        if largest > FULL_SCALE + SLACK:
            return JointUnit("degree", f"{modes}, and a state reaches {largest:.4g}")
        return JointUnit("", f"{modes}, the files do not say which, and no state exceeds {largest:.4g}")
    who = f"robots of type {robot}" if robot else "a robot without a type"
    if largest <= ONE_TURN:
        return JointUnit("radian", f"of {who} no unit is known, and no state exceeds one turn in radians")
    return JointUnit("", f"of {who} no unit is known, and a state reaches {largest:.4g}")


def require_unit(dataset: LerobotDataset, unit: JointUnit) -> None:
    """Raise a ValueError that says what to do where the user must give the unit."""
    if not unit.name:
        raise ValueError(
            f"{dataset.path}: no unit of the joints: {unit.reason}. Give joint_unit, one of "
            f"{', '.join(JOINT_UNITS)} (diagnose.joint_unit=degree, recording.lerobot.joint_unit=degree)"
        )


def convert(columns: Mapping[str, np.ndarray], unit: JointUnit) -> dict[str, np.ndarray]:
    """The columns with angles in radians, where they are written in degrees."""
    return {
        name: values * unit.factor if is_joint(name) and not is_gripper(name) else values
        for name, values in columns.items()
    }


def describe_unit(unit: JointUnit, columns: Iterable[str]) -> str:
    """What was done to the joints, in a sentence."""
    done = {"degree": "converted from degrees to radians", "radian": "taken as radians"}
    text = f"joints are {done.get(unit.name, 'kept as written')}: {unit.reason}"
    grippers = [name for name in columns if is_gripper(name)]
    return f"{text}; {', '.join(grippers)} kept as written, as grippers" if grippers else text
