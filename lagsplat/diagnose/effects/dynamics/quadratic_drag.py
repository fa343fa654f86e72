"""Drag that grows with the square of the speed: ``Q = -m coefficient |v| v``."""

from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-coefficient |v| v``."""
    return -theta[0] * abs(v) * v


EFFECT = ForceEffect(
    name="quadratic_drag",
    group="B",
    component="dissipative",
    equation="a = -coefficient |v| v",
    parameters=(EffectParameter("coefficient", "per_coordinate", HalfNormal(0.2)),),
    needs="amplitudes that differ threefold",
    passive=True,
    law=force,
    together=True,
)
