"""Hardening or softening: ``Q = -m coefficient s^3``."""

from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-coefficient s^3``."""
    return -theta[0] * s * s * s


EFFECT = ForceEffect(
    name="cubic_stiffness",
    group="A",
    component="conservative",
    equation="a = -coefficient s^3",
    parameters=(EffectParameter("coefficient", "cubic", Normal(0.3)),),
    needs="two amplitudes, one at least twice the other",
    law=force,
)
