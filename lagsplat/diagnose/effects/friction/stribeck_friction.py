"""Stribeck friction: stronger at rest than in motion.

Source: Armstrong-Helouvry, Dupont and Canudas de Wit, doi:10.1016/0005-1098(94)90209-7.
"""

import math

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import PRESLIDING, EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-coulomb (1 + excess exp(-(v/velocity)^2)) sign(v)``."""
    ratio = v / theta[2]
    return -math.copysign(theta[0] * (1.0 + theta[1] * math.exp(-ratio * ratio)), v)


EFFECT = ForceEffect(
    name="stribeck_friction",
    group="B",
    number=2,
    component="dissipative",
    equation="a = -(coulomb + (static - coulomb) exp(-(v/velocity)^2)) sign(v)",
    parameters=(
        EffectParameter("coulomb", "acceleration", HalfNormal(0.2)),
        EffectParameter("excess", "ratio", HalfNormal(1.0), (0.3, 1.0)),
        EffectParameter("velocity", "velocity", log_normal(0.3, 0.8), (0.1, 0.3, 0.8)),
        *PRESLIDING,
    ),
    needs="a tenth of the samples slower than the Stribeck velocity",
    between_variants=("",),
    law=force,
    dry=("",),
    report_parameters=lambda p, placed: {
        "coulomb": p["coulomb"],
        "static": p["coulomb"] * (1.0 + p["excess"]),
        "velocity": p["velocity"],
        "presliding": p["presliding"],
    },
    confusable_with=("coulomb_friction", "load_dependent_friction", "hysteresis"),
    mujoco="the friction loss of a joint does not depend on its speed.",
    title="dry friction that sticks",
    what="A rubbing contact holds harder at rest than it resists while sliding.",
    symptom="Slow motion goes in jerks: it sticks, breaks loose and slips.",
    remedy="Add Stribeck friction to the simulation, or lubricate.",
    short_title="Stribeck friction",
)
