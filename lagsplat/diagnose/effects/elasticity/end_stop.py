"""A stop on one side: beyond ``position`` a stiff spring pushes back and loses energy.

Source: Hunt and Crossley, doi:10.1115/1.3423596.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from lagsplat.diagnose.effects.base import ForceEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law

SIDE = {"upper": 1.0, "lower": -1.0}
LIMIT_IMPEDANCE = 0.005  # of a MuJoCo limit that adds its force to the others instead of taking their place


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-stiffness_ratio omega^2 depth (1 + loss v)``, never pulling; the depth starts smoothly."""
    side, width = theta[4], theta[5]
    x = (side * s - theta[1]) / width
    depth = width * (x if x > 30.0 else math.log1p(math.exp(x)))
    return -side * theta[0] * theta[3] * depth * max(1.0 + theta[2] * side * v, 0.0)


def _report_parameters(parameters: Mapping[str, float], placed: PlacedEffect) -> dict[str, Any]:
    """The position as a value of the coordinate instead of a distance from rest."""
    assert placed.direction is not None
    position = placed.direction.rest + parameters["position"] * SIDE[placed.variant]
    return {"position": position, "stiffness_ratio": parameters["stiffness_ratio"]}


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Limit the range of the joint on one side, if it has no limit yet."""
    joint, push = element.joint, float(values["stiffness_ratio"]) * element.placed.scales.stiffness
    if push <= 0.0 or element.selection.model.joint(joint.name).limited[0]:
        return ()
    far = 1e3 * (1.0 + abs(values["position"]))
    edge = element.rest + SIDE[element.placed.variant] * float(values["position"])
    joint.limited = int(element.mujoco.mjtLimited.mjLIMITED_TRUE)
    between = np.array([edge - far, edge] if element.placed.variant == "upper" else [edge, edge + far])
    joint.range = between / element.angle_unit
    # a negative reference is a stiffness; so low an impedance leaves the other forces as they are
    joint.solref_limit = np.array([-push * element.inertia * element.compliance, -1e-9])
    joint.solimp_limit = np.array([LIMIT_IMPEDANCE, LIMIT_IMPEDANCE, 0.001, 0.5, 2.0])
    row = element.format_row
    return (f"joint {joint.name}: range {row(between)}, solreflimit {row(joint.solref_limit)}",)


EFFECT = ForceEffect(
    name="end_stop",
    group="E",
    number=1,
    component="conservative",
    equation="a = -stiffness_ratio omega^2 max(s - position, 0)",
    parameters=(
        EffectParameter("stiffness_ratio", "ratio", log_normal(10.0, 1.5), (10.0,)),
        EffectParameter("position", "reach", log_normal(0.8, 0.25), (0.3, 0.5, 0.65, 0.8, 0.9)),
        EffectParameter("loss", "slowness", HalfNormal(1.0), (0.05,)),
    ),
    needs="motion past the stop at three speeds",
    variants=("upper", "lower"),
    law=force,
    constants=lambda scales, variant: (scales.stiffness, SIDE[variant], 0.01 * scales.coordinate),
    report_parameters=_report_parameters,
    confusable_with=("cubic_stiffness",),
    mujoco=to_mujoco,
    title="a stop or a contact on one side",
    what="Beyond some position the mechanism runs into something stiff.",
    symptom="Motion is cut off on one side only, with a sudden turn.",
    remedy="Add the stop to the simulation, or clear what is in the way.",
)
