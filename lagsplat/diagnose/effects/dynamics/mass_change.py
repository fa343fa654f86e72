"""Another inertia than the sim's: ``M -> ratio M``; what hangs has weight too, ``V -> ratio V``."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch, ModelEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def change(
    fields: CoefficientBatch, theta: Float64[np.ndarray, "P 1"], instance: PlacedEffect, model: Any
) -> CoefficientBatch:
    """``M`` times ``ratio``, and ``V`` too where the variant is ``weight``."""
    ratio = np.exp(theta[:, 0])
    if instance.direction is not None:
        p = instance.direction.covector
        added = (ratio - 1.0)[:, None, None] * instance.direction.inertia * np.outer(p, p)
        mass = fields.mass.copy()
        mass[:, 0] += added
        return replace(fields, mass=mass)
    mass = fields.mass * ratio[:, None, None, None]
    if instance.variant != "weight":
        return replace(fields, mass=mass)
    return replace(fields, mass=mass, potential=fields.potential * ratio[:, None])


EFFECT = ModelEffect(
    name="mass_change",
    group="A",
    component="inertial",
    equation="M = ratio M_sim (and V = ratio V_sim where the mass hangs)",
    parameters=(EffectParameter("ratio", "log_ratio", Normal(0.3)),),
    needs="a static hold and a motion, both under known inputs",
    along="both",
    variants=("", "weight"),
    change=change,
)
