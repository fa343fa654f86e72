"""Free play about rest: within ``gap`` of it the spring does not act."""

from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``omega^2 (s - s beyond the gap)``: takes the spring away within the gap, and the gap beyond it."""
    return theta[1] * min(max(s, -theta[0]), theta[0])


EFFECT = ForceEffect(
    name="joint_backlash",
    group="D",
    component="conservative",
    equation="a = omega^2 clip(s, -gap, gap)",
    parameters=(EffectParameter("gap", "coordinate", log_normal(0.2, 1.0), (0.05, 0.15, 0.4, 0.8)),),
    needs="a decay through small amplitudes",
    amplitudes=0,
    law=force,
    constants=lambda scales, variant: (scales.stiffness,),
)
