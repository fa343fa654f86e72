"""Viscoelastic creep: a spring in series with a dashpot beside the mechanism's own (linear solid)."""

from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-k (s - x)`` with ``dx/dt = (s - x) / time_constant`` and ``k = stiffness_ratio omega^2``."""
    late = s - memory[0]
    d_memory[0] = late / theta[1]
    return -theta[0] * theta[2] * late


EFFECT = ForceEffect(
    name="creep",
    group="D",
    component="memory",
    equation="a = -stiffness_ratio omega^2 (s - x), time_constant dx/dt = s - x",
    parameters=(
        EffectParameter("stiffness_ratio", "ratio", HalfNormal(0.3)),
        EffectParameter("time_constant", "time", log_normal(2.0, 1.2), (0.5, 2.0, 6.0, 20.0)),
    ),
    needs="a step held for three time constants, and cycles",
    passive=True,
    between=("",),
    law=force,
    n_memory=1,
    memory_start=("s",),
    memory_kinds=("coordinate",),
    constants=lambda scales, variant: (scales.stiffness,),
)
