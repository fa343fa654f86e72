"""Coulomb friction that grows with the load on the joint, as in gears.

Source: Duclusaud et al., "Extended friction models for the physics simulation of servo actuators", 2024.
"""

import math
from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-(acceleration + load_factor |load|) sign(v)``, the load being what spring and drive press with."""
    return -(theta[1] + theta[0] * abs(spring - drive)) * math.tanh(v / theta[2])


EFFECT = ForceEffect(
    name="load_dependent_friction",
    group="B",
    component="dissipative",
    equation="a = -(acceleration + load_factor |load|) sign(v)",
    parameters=(
        EffectParameter("load_factor", "ratio", HalfNormal(0.2)),
        EffectParameter("acceleration", "acceleration", HalfNormal(0.1)),
    ),
    needs="two static loads or poses",
    amplitudes=2,
    passive=True,
    law=force,
    constants=lambda scales, variant: (0.02 * scales.velocity,),
    reports=lambda p, instance: {"acceleration": p["acceleration"], "load_factor": p["load_factor"]},
)
