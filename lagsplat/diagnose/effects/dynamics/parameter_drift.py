"""A parameter that changes slowly: the stiffness by ``rate`` a second, or a load; the change may bend."""

from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, Scales
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``rate t + bend t^2 / duration`` times the conservative force, or times the unit of acceleration."""
    return (theta[0] + theta[1] * t / theta[3]) * t * (spring if theta[2] == 0.0 else theta[2])


def _constants(scales: Scales, variant: str) -> tuple[float, ...]:
    return (0.0 if variant == "" else scales.of("acceleration"), scales.duration_s)


EFFECT = ForceEffect(
    name="parameter_drift",
    group="E",
    component="exogenous",
    equation="V = (1 + rate t + bend t^2 / duration) V_sim, or a likewise",
    parameters=(
        EffectParameter("rate", "per_duration", Normal(0.15)),
        EffectParameter("bend", "per_duration", Normal(0.05)),
    ),
    amplitudes=2,
    needs="the same motion early and late",
    variants=("", "load"),
    variant_units={"load": "{q}/s^3"},
    law=force,
    constants=_constants,
    reports=lambda p, instance: {
        "rate": p["rate"] * (_constants(instance.scales, instance.variant)[0] or 1.0)
    },
)
