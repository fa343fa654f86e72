"""A parameter that changes slowly: the stiffness by ``rate`` a second, or a load."""

from typing import no_type_check

from lagsplat.diagnose.effects.effect import Force, Normal, Parameter, Scales
from lagsplat.diagnose.kernel import law


@law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``rate t`` times the conservative force, or times the unit of acceleration."""
    return theta[0] * t * (spring if theta[1] == 0.0 else theta[1])


def _constants(scales: Scales, variant: str) -> tuple[float, ...]:
    return (0.0 if variant == "" else scales.of("acceleration"),)


EFFECT = Force(
    name="parameter_drift",
    group="E",
    component="exogenous",
    equation="V = (1 + rate t) V_sim, or a = rate t",
    parameters=(Parameter("rate", "per_duration", Normal(0.15)),),
    needs="the same motion early and late",
    variants=("", "load"),
    law=force,
    constants=_constants,
    reports=lambda p, instance: {
        "rate": p["rate"] * (_constants(instance.scales, instance.variant)[0] or 1.0)
    },
)
