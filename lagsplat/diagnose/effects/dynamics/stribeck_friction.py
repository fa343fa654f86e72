"""Stribeck friction: stronger at rest than in motion.

Source: Armstrong-Helouvry, Dupont and Canudas de Wit, doi:10.1016/0005-1098(94)90209-7.
"""

import math
from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-coulomb (1 + excess exp(-(v/velocity)^2)) sign(v)``."""
    ratio = v / theta[2]
    return -theta[0] * (1.0 + theta[1] * math.exp(-ratio * ratio)) * math.tanh(v / theta[3])


EFFECT = ForceEffect(
    name="stribeck_friction",
    group="B",
    component="dissipative",
    equation="a = -(coulomb + (static - coulomb) exp(-(v/velocity)^2)) sign(v)",
    parameters=(
        EffectParameter("coulomb", "acceleration", HalfNormal(0.2)),
        EffectParameter("excess", "ratio", HalfNormal(1.0), (0.3, 1.0)),
        EffectParameter("velocity", "velocity", log_normal(0.3, 0.8), (0.1, 0.3, 0.8)),
    ),
    needs="a tenth of the samples slower than the Stribeck velocity",
    passive=True,
    between=("",),
    law=force,
    constants=lambda scales, variant: (0.02 * scales.velocity,),
    reports=lambda p, instance: {
        "coulomb": p["coulomb"],
        "static": p["coulomb"] * (1.0 + p["excess"]),
        "velocity": p["velocity"],
    },
)
