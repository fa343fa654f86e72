"""A stop on one side: beyond ``position`` a stiff spring pushes back, and loses energy.

Source: Hunt and Crossley, doi:10.1115/1.3423596.
"""

import math
from collections.abc import Mapping
from typing import Any, no_type_check

from lagsplat.diagnose.effects.base import ForceEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, Scales, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-stiffness_ratio omega^2 depth (1 + loss v)``, never pulling; the depth is smooth within a width."""
    side, width = theta[4], theta[5]
    x = (side * s - theta[1]) / width
    depth = width * (x if x > 30.0 else math.log1p(math.exp(x)))
    return -side * theta[0] * theta[3] * depth * max(1.0 + theta[2] * side * v, 0.0)


def _constants(scales: Scales, variant: str) -> tuple[float, ...]:
    return scales.stiffness, (1.0 if variant == "upper" else -1.0), 0.01 * scales.coordinate


def _told(parameters: Mapping[str, float], instance: PlacedEffect) -> dict[str, Any]:
    """The position as a value of the coordinate, on either side of rest."""
    assert instance.direction is not None
    away = parameters["position"] * (1.0 if instance.variant == "upper" else -1.0)
    return {
        "position": instance.direction.rest + away,
        "stiffness_ratio": parameters["stiffness_ratio"],
    }


EFFECT = ForceEffect(
    name="end_stop",
    group="E",
    component="conservative",
    equation="a = -stiffness_ratio omega^2 max(s - position, 0)",
    parameters=(
        EffectParameter("stiffness_ratio", "ratio", log_normal(10.0, 1.5), (10.0,)),
        EffectParameter("position", "reach", log_normal(0.8, 0.25), (0.3, 0.5, 0.65, 0.8, 0.9)),
        EffectParameter("loss", "slowness", HalfNormal(1.0), (0.05,)),
    ),
    reports=_told,
    needs="motion past the stop at three speeds",
    amplitudes=0,
    passive=True,
    variants=("upper", "lower"),
    law=force,
    constants=_constants,
)
