"""Viscous damping that differs from the sim's: ``Q = -rate m v``, real minus sim."""

from dataclasses import replace
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch, ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-rate v``."""
    return -theta[0] * v


def whole(fields: CoefficientBatch, theta: Float64[np.ndarray, "P 1"], model: Any) -> CoefficientBatch:
    """Damping in proportion to the inertia at rest."""
    damping = fields.damping.copy()
    damping[:, 0] += theta[:, :1, None] * model.inertia
    return replace(fields, damping=damping)


EFFECT = ForceEffect(
    name="viscous_damping",
    group="A",
    component="dissipative",
    equation="a = -rate v",
    parameters=(EffectParameter("rate", "rate", Normal(0.2)),),
    needs="ring-downs at two amplitudes",
    along="both",
    between=("",),
    law=force,
    together=True,
    whole=whole,
)
