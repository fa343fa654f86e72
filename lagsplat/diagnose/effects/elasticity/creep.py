"""Viscoelastic creep of a linear solid: a spring in series with a dashpot, beside the mechanism's spring."""

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-k (s - x)`` with ``dx/dt = (s - x) / time_constant`` and ``k = stiffness_ratio omega^2``."""
    late = s - memory[0]
    d_memory[0] = late / theta[1]
    return -theta[0] * theta[2] * late


EFFECT = ForceEffect(
    name="creep",
    group="D",
    number=2,
    component="memory",
    equation="a = -stiffness_ratio omega^2 (s - x), time_constant dx/dt = s - x",
    parameters=(
        EffectParameter("stiffness_ratio", "ratio", HalfNormal(0.3)),
        EffectParameter("time_constant", "time", log_normal(2.0, 1.2), (0.5, 2.0, 6.0, 20.0)),
    ),
    needs="a step held for three time constants, and cycles",
    between_variants=("",),
    law=force,
    memory_start=("s",),
    constants=lambda scales, variant: (scales.stiffness,),
    confusable_with=("viscous_damping", "linear_stiffness", "parameter_drift"),
    flexible=True,
    mujoco="springs of joints have no internal state; it would need a massless body in series.",
    title="creep of a soft material",
    what="The material yields slowly under load and recovers slowly afterwards.",
    symptom="After a step it keeps moving for long, and losses peak at one rate of motion.",
    remedy="Add a spring in series with a dashpot to the simulation.",
)
