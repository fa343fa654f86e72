"""A constant force: tilt, preload, an offset of an actuator."""

from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``acceleration``."""
    return theta[0]


EFFECT = ForceEffect(
    name="constant_force",
    group="A",
    component="conservative",
    equation="a = acceleration",
    parameters=(EffectParameter("acceleration", "acceleration", Normal(0.3)),),
    needs="a stretch at rest",
    law=force,
    together=True,
)
