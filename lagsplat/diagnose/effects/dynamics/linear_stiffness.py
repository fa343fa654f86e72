"""A stiffer or softer return to rest: the sim's potential times ``ratio``, or a spring beside it.

A spring that is missed beside gravity is no share of the potential: at a large angle the two part.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch, ForceEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, Scales
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law

SPRING = "spring"
SOFT = 0.1
"""Stiffness of the sim at rest, in units of the motion's mean square rate, below which it counts for none."""


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``(ratio - 1)`` times the conservative force of the sim, or that of a spring ``-omega^2 s``."""
    return (math.exp(theta[0]) - 1.0) * (theta[1] * spring - theta[2] * s)


def whole(fields: CoefficientBatch, theta: Float64[np.ndarray, "P 1"], model: Any) -> CoefficientBatch:
    """The potential times ``ratio``."""
    return replace(fields, potential=fields.potential * np.exp(theta[:, :1]))


def _shares(scales: Scales, variant: str) -> tuple[float, float]:
    """How much of the sim's own force, and the ``omega^2`` of a spring."""
    return (0.0, stiffness(scales)) if variant == SPRING else (1.0, 0.0)


def stiffness(scales: Scales) -> float:
    """What a spring's ratio is of [1/s^2]: the sim's stiffness at rest, or where it has none the motion's."""
    swung = scales.of("rate") ** 2
    return scales.stiffness if scales.stiffness > SOFT * swung else swung


def _told(values: Mapping[str, float], one: PlacedEffect) -> dict[str, float]:
    """The ratio; a spring beside no stiffness has none, and is told by itself."""
    if one.variant != SPRING or stiffness(one.scales) == one.scales.stiffness:
        return dict(values)
    return {"added_stiffness": (values["ratio"] - 1.0) * stiffness(one.scales)}


EFFECT = ForceEffect(
    name="linear_stiffness",
    group="A",
    component="conservative",
    equation="V = ratio V_sim, or V = V_sim + (ratio - 1) m omega^2 s^2 / 2",
    parameters=(EffectParameter("ratio", "log_ratio", Normal(0.3)),),
    needs="free motion, or a static hold under a known input",
    along="both",
    variants=("", SPRING),
    between=(SPRING,),
    reports=_told,
    law=force,
    constants=_shares,
    whole=whole,
)
