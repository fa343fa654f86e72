"""Reflected inertia of a rotor: a constant inertia along one coordinate, without weight.

Source: Siciliano et al., "Robotics", 2009, sec. 7.1.1, doi:10.1007/978-1-84628-642-1.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch, ModelEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal


def add_inertia(
    coefficients: CoefficientBatch, ratio: Float64[np.ndarray, " P"], placed: PlacedEffect
) -> CoefficientBatch:
    """Add ``ratio`` times the reference inertia along the direction."""
    assert placed.direction is not None
    p, mass = placed.direction.covector, coefficients.mass.copy()
    mass[:, 0] += ratio[:, None, None] * placed.direction.inertia * np.outer(p, p)
    return replace(coefficients, mass=mass)


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Raise the armature of the joint."""
    joint = element.joint
    joint.armature = float(joint.armature) + values["ratio"] * element.inertia
    return (f"joint {joint.name}: armature {joint.armature:.6g}",)


EFFECT = ModelEffect(
    name="armature",
    group="A",
    number=7,
    component="inertial",
    equation="M = M_sim + ratio m along one coordinate",
    parameters=(EffectParameter("ratio", "ratio", HalfNormal(0.3), label="ratio (added to simulated)"),),
    needs="slow and fast motion of each joint under known inputs",
    acts_everywhere=True,
    # of a single coordinate with constant inertia it is a change of mass
    place=lambda effect, finder: (
        []
        if finder.constant_inertia and len(finder.coordinates) == 1
        else finder.find_along_coordinates(effect)
    ),
    change=lambda coefficients, theta, placed, model: add_inertia(coefficients, theta[:, 0], placed),
    confusable_with=("mass_change", "payload", "linear_stiffness", "input_gain"),
    mujoco=to_mujoco,
    title="the inertia of a rotor that the simulation does not have",
    kind="parameter",
    what="A motor turns along behind its gear and adds inertia to one joint, but no weight.",
    symptom="One joint answers more slowly at every speed, yet holds loads as predicted.",
    remedy="Give that joint of the simulation the rotor inertia times the square of the gear ratio.",
)
