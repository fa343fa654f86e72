"""A stiffness that varies periodically in time.

Source: Mathieu's equation, Nayfeh and Mook, "Nonlinear Oscillations", 1995, ch. 5, doi:10.1002/9783527617586.
"""

import math

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.external.external_periodic_force import measure_recurrence, place_at_lines
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-unit s (cosine cos(omega t) + sine sin(omega t))``."""
    return -theta[3] * s * (theta[0] * math.cos(theta[2] * t) + theta[1] * math.sin(theta[2] * t))


EFFECT = ForceEffect(
    name="parametric_stiffness",
    group="E",
    number=5,
    component="conservative",
    equation="a = -depth omega^2 cos(2 pi frequency t + phase) s",
    parameters=(
        EffectParameter("cosine", "ratio", Normal(0.2)),
        EffectParameter("sine", "ratio", Normal(0.2)),
        EffectParameter("angular_frequency", "rate", log_normal(1.5, 0.8), (0.5, 1.0, 2.0, 3.0)),
    ),
    needs="fifteen swings or more",
    place=lambda effect, finder: place_at_lines(
        effect, finder, [hint.stiffness_lines_hz for hint in finder.hints]
    ),
    law=force,
    constants=lambda scales, variant: (scales.of("rate") ** 2,),
    report_parameters=lambda p, placed: {
        "depth": math.hypot(p["cosine"], p["sine"]),
        "frequency_hz": p["angular_frequency"] / (2.0 * math.pi),
    },
    report_units={"depth": "1"},
    confusable_with=("external_periodic_force", "parameter_drift"),
    flexible=True,
    recurrence=measure_recurrence,
    mujoco="parameters of a model do not depend on time.",
    title="a stiffness that changes periodically",
    what="The pull back to rest rises and falls by a rhythm of its own, as of teeth or a turning shaft.",
    symptom="Swings grow and shrink with a rhythm, and grow without end at twice the natural frequency.",
    remedy="Let the simulation's stiffness depend on time, or find what changes it.",
)
