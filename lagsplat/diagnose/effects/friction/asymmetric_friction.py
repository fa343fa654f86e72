"""Friction that differs between both directions: dry, viscous or between the two."""

import math

from lagsplat.diagnose.data_quality.excitation_measures import ExcitationMeasures
from lagsplat.diagnose.effects.base import ForceEffect, Grade
from lagsplat.diagnose.effects.excitation import ask_for_decay, describe_reversals, make_grade
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-forward`` or ``-backward``, by the sign of ``v``, times a power of the speed."""
    level = theta[0] if v > 0.0 else theta[1]
    return -level * math.tanh(v / theta[3]) * (abs(v) / theta[4] + 1e-3) ** theta[2]


def grade_excitation(measures: ExcitationMeasures) -> Grade:
    """It shows in the losses of both half-swings, and dry friction best where it comes to rest."""
    yes = measures.reversals >= 8 and measures.amplitude_ratio > 1.8
    return make_grade(yes, measures.reversals >= 4, describe_reversals(measures), ask_for_decay(measures))


EFFECT = ForceEffect(
    name="asymmetric_friction",
    group="B",
    number=6,
    component="dissipative",
    equation="a = -(forward for v > 0, backward for v < 0) (|v| / rms v)^power sign(v)",
    parameters=(
        EffectParameter("forward", "acceleration", HalfNormal(0.2)),
        EffectParameter("backward", "acceleration", HalfNormal(0.2)),
        # 0 is dry, 1 viscous
        EffectParameter("power", "ratio", HalfNormal(0.7), (0.01, 0.4, 1.0)),
    ),
    needs="motion in both directions at several speeds",
    law=force,
    constants=lambda scales, variant: (0.02 * scales.velocity, scales.velocity),
    passive=True,
    report_units={"power": "1"},
    excitation=grade_excitation,
    confusable_with=("coulomb_friction", "viscous_damping", "constant_force"),
    # has dry and viscous friction as special cases
    log_prior_penalty=2.0,
    mujoco="friction loss and damping of a joint are the same in both directions.",
    title="friction that differs between both directions",
    kind="mechanism",
    what="A lip seal, a ratchet or a valve resists more in one direction than in the other.",
    symptom="Half-swings in one direction lose more than those in the other, and the mean is pushed aside.",
    remedy="Give the simulation friction of its own for each direction.",
)
