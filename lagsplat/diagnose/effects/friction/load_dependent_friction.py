"""Coulomb friction that grows with the load on the joint, as in gears.

Source: Duclusaud et al., "Extended friction models for the physics simulation of servo actuators", 2024.
"""

import math

from lagsplat.diagnose.data_quality.excitation_measures import ExcitationMeasures
from lagsplat.diagnose.effects.base import ForceEffect, Grade
from lagsplat.diagnose.effects.excitation import make_grade
from lagsplat.diagnose.effects.parameters import PRESLIDING, EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-(acceleration + load_factor |load|) sign(v)``; the load is what the drive bears.

    The pull of a position controller, ``-kp q``, is of the drive, though a simulator has it as a spring.
    """
    pull = theta[4] * (s + theta[5])
    return -math.copysign(theta[1] + theta[0] * abs(spring + pull - (drive - pull)), v)


def grade_excitation(measures: ExcitationMeasures) -> Grade:
    """It shows at two loads or more."""
    loads = measures.holds >= 2 or any(channel.levels >= 3 for channel in measures.inputs)
    weak = measures.amplitude_ratio > 2.0 and measures.reversals >= 6
    reason = f"{measures.reversals} reversals, {'several' if loads else 'one'} static load(s)"
    record = f"record {10 * measures.period_s:.3g} s of small swings about each of two loaded poses"
    return make_grade(loads and weak and measures.reversals >= 8, weak, reason, record)


EFFECT = ForceEffect(
    name="load_dependent_friction",
    group="B",
    number=3,
    component="dissipative",
    equation="a = -(acceleration + load_factor |load|) sign(v)",
    parameters=(
        EffectParameter("load_factor", "ratio", HalfNormal(0.2)),
        EffectParameter("acceleration", "acceleration", HalfNormal(0.1)),
        *PRESLIDING,
    ),
    needs_all_forces=True,
    needs="two static loads or poses",
    place=lambda effect, finder: finder.find_along_controlled(effect),
    law=force,
    dry=("",),
    excitation=grade_excitation,
    confusable_with=("coulomb_friction", "stribeck_friction", "hysteresis"),
    mujoco="the friction loss of a joint does not depend on the load that it carries.",
    title="friction that grows with load",
    what="A bearing or gear rubs more the harder it is pressed.",
    symptom="Losses differ between poses, or between weak and strong inputs, at equal speed.",
    remedy="Let the simulation's friction depend on the load that the joint carries.",
)
