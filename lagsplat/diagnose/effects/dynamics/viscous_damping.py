"""Viscous damping that differs from the sim's: ``Q = -rate m v``, real minus sim."""

from dataclasses import replace
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import Fields, Force, Normal, Parameter
from lagsplat.diagnose.solvers.runge_kutta import law


@law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-rate v``."""
    return -theta[0] * v


def whole(fields: Fields, theta: Float64[np.ndarray, "P 1"], model: Any) -> Fields:
    """Damping in proportion to the inertia at rest."""
    damping = fields.damping.copy()
    damping[:, 0] += theta[:, :1, None] * model.inertia
    return replace(fields, damping=damping)


EFFECT = Force(
    name="viscous_damping",
    group="A",
    component="dissipative",
    equation="a = -rate v",
    parameters=(Parameter("rate", "rate", Normal(0.2)),),
    needs="ring-downs at two amplitudes",
    along="both",
    between=("",),
    law=force,
    together=True,
    whole=whole,
)
