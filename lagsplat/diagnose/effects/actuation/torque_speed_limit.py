"""A motor whose largest torque falls with its speed, as supply and back-EMF allow.

Source: Hughes and Drury, "Electric Motors and Drives", 2019, ch. 3, doi:10.1016/C2017-0-03226-3.
"""

from lagsplat.diagnose.effects.base import ForceEffect, PlacedEffect, PlaceFinder
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return the drive within its limits less the drive; forward the limit is ``stall (1 - v / no_load)``.

    The pull of a position controller, ``-kp q``, is of the drive, though a simulator has it as a spring.
    """
    drive -= theta[2] * (s + theta[3])
    stall, speed = theta[0], v / theta[1]
    most = stall * min(max(1.0 - speed, 0.0), 1.0)
    least = -stall * min(max(1.0 + speed, 0.0), 1.0)
    return min(max(drive, least), most) - drive


def place(effect: ForceEffect, finder: PlaceFinder) -> list[PlacedEffect]:
    """Along each coordinate that inputs drive."""
    along = finder.find_along_controlled(effect)
    return [placed for placed in along if finder.inputs and placed.scales.drive > 0.0]


EFFECT = ForceEffect(
    name="torque_speed_limit",
    group="C",
    number=6,
    component="actuation",
    level="actuation",
    equation="a_drive = clip(a_drive, -stall (1 + v / no_load), stall (1 - v / no_load))",
    parameters=(
        EffectParameter("stall", "drive", log_normal(1.5, 0.7), (0.8, 1.3, 2.0, 3.0)),
        EffectParameter("no_load", "velocity", log_normal(2.0, 0.7), (0.8, 1.5, 2.5, 4.0)),
    ),
    needs_all_forces=True,
    needs="strong inputs at high and at low speed",
    place=place,
    law=force,
    confusable_with=("input_saturation", "viscous_damping", "input_gain"),
    mujoco="the force range of an actuator does not depend on its speed.",
    title="a motor that gives less torque the faster it turns",
    what="Back-EMF and a supply that sags leave less torque at high speed than at rest.",
    symptom="Strong commands are answered too weakly, and most so while it moves fast the same way.",
    remedy="Give the simulation the torque-speed line of the motor, or command less at speed.",
)
