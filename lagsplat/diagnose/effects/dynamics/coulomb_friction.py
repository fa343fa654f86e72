"""Coulomb friction, smooth within a small speed: ``Q = -m acceleration tanh(v / 0.02 rms v)``."""

import math
from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-acceleration sign(v)``."""
    return -theta[0] * math.tanh(v / theta[1])


EFFECT = ForceEffect(
    name="coulomb_friction",
    group="B",
    component="dissipative",
    equation="a = -acceleration sign(v)",
    parameters=(EffectParameter("acceleration", "acceleration", HalfNormal(0.2)),),
    needs="a decay down to rest, or slow reversals",
    passive=True,
    between=("",),
    law=force,
    together=True,
    constants=lambda scales, variant: (0.02 * scales.velocity,),
)
