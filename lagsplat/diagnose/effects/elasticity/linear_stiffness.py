"""Another stiffness: the potential of the simulation times ``ratio``, or a spring beside it.

A spring that is missed beside gravity is no share of the potential: at a large angle the two part.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from lagsplat.diagnose.effects.base import ForceEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, Scales
from lagsplat.diagnose.solvers.force_laws import compile_force_law

SPRING = "spring"
SOFT = 0.1  # stiffness at rest, over the motion's mean square rate, below which a model counts as having none


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``(ratio - 1)`` times the conservative force of the model, or of a spring ``-omega^2 s``."""
    return (math.exp(theta[0]) - 1.0) * (theta[1] * spring - theta[2] * s)


def choose_spring_unit(scales: Scales) -> float:
    """What the ratio of a spring is of [1/s^2]: the stiffness at rest, or of the motion beside hardly any."""
    of_motion = scales.of("rate") ** 2
    return of_motion if scales.stiffness <= SOFT * of_motion else scales.stiffness


def _report_parameters(values: Mapping[str, float], placed: PlacedEffect) -> dict[str, float]:
    """The ratio; where the model has hardly any stiffness, the stiffness of the added spring."""
    unit = choose_spring_unit(placed.scales)
    if placed.variant != SPRING or unit == placed.scales.stiffness:
        return dict(values)
    return {"added_stiffness": (values["ratio"] - 1.0) * unit}


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Scale gravity, springs and what servos hold with; or add a spring."""
    if element.placed.variant == SPRING:
        added = (values["ratio"] - 1.0) * choose_spring_unit(element.placed.scales)
        return element.add_spring(added * element.inertia * Polynomial([-element.rest, 1.0]))
    ratio, gravity = values["ratio"], element.spec.option.gravity
    if element.joint is not None and len(element.selection.joints) > 1:
        return () if gravity.any() else element.scale_springs([element.joint], ratio)
    gravity *= ratio
    joints = [joint for joint in element.spec.joints if joint.name in element.selection.joints]
    springs = element.scale_springs(joints, ratio)
    for actuator in element.spec.actuators:
        actuator.biasprm[:2] *= ratio
    return (*springs, f"gravity {element.format_row(gravity)}")


EFFECT = ForceEffect(
    name="linear_stiffness",
    group="A",
    number=2,
    component="conservative",
    equation="V = ratio V_sim, or V = V_sim + (ratio - 1) m omega^2 s^2 / 2",
    parameters=(EffectParameter("ratio", "log_ratio", Normal(0.3), label="ratio (real to simulated)"),),
    needs="free motion, or a static hold under a known input",
    variants=("", SPRING),
    along="both",
    between_variants=(SPRING,),
    law=force,
    constants=lambda scales, variant: (0.0, choose_spring_unit(scales)) if variant == SPRING else (1.0, 0.0),
    whole=lambda coefficients, theta, model: replace(
        coefficients, potential=coefficients.potential * np.exp(theta[:, :1])
    ),
    # a scaled potential keeps its bounds; a spring that is taken away may not
    report_parameters=_report_parameters,
    report_units={"added_stiffness": "1/s^2"},
    confusable_with=("mass_change", "input_gain", "viscous_damping", "creep", "parameter_drift"),
    mujoco=to_mujoco,
    title="another stiffness than the simulation's",
    kind="parameter",
    what="What pulls the mechanism back to rest is stronger or weaker than in the simulation.",
    symptom="It swings at another frequency, and a steady load deflects it by another amount.",
    remedy="Set the simulation's stiffness anew.",
)
