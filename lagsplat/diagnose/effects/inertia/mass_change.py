"""Another inertia than the simulation's: ``M -> ratio M``, and ``V -> ratio V`` where the mass hangs."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch, ModelEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal

WEIGHT = "weight"  # variant in which the mass hangs, so that gravity acts on it


def change(
    coefficients: CoefficientBatch, theta: Float64[np.ndarray, "P 1"], placed: PlacedEffect, model: Any
) -> CoefficientBatch:
    """Multiply ``M`` by ``ratio``, and ``V`` too where the mass hangs."""
    ratio = np.exp(theta[:, 0])
    mass = coefficients.mass * ratio[:, None, None, None]
    if placed.variant != WEIGHT:
        return replace(coefficients, mass=mass)
    return replace(coefficients, mass=mass, potential=coefficients.potential * ratio[:, None])


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Scale all masses; gravity makes up for a mass without weight."""
    ratio, spec = values["ratio"], element.spec
    element.scale_masses(ratio)
    for other in spec.joints:
        other.armature = ratio * float(other.armature)
    masses = f"all masses times {ratio:.6g}"
    if element.placed.variant == WEIGHT:
        return (masses, *element.scale_springs(spec.joints, ratio))
    spec.option.gravity /= ratio
    return (masses, f"gravity {element.format_row(spec.option.gravity)}, so that the weight stays")


EFFECT = ModelEffect(
    name="mass_change",
    group="A",
    number=3,
    component="inertial",
    equation="M = ratio M_sim (and V = ratio V_sim where the mass hangs)",
    parameters=(EffectParameter("ratio", "log_ratio", Normal(0.3), label="ratio (real to simulated)"),),
    needs_all_forces=True,
    needs="a static hold and a motion, both under known inputs",
    variants=("", WEIGHT),
    along="whole",
    change=change,
    confusable_with=("linear_stiffness", "input_gain", "viscous_damping", "hidden_mode"),
    mujoco=to_mujoco,
    title="another mass than the simulation's",
    kind="parameter",
    what="All of the mechanism is heavier or lighter than in the simulation.",
    symptom="It swings at another frequency and fades at another rate, yet rests where it should.",
    remedy="Weigh the mechanism, and set the simulation's inertia anew.",
)
