"""Coulomb friction that grows with the load on the joint, as in gears.

Source: Duclusaud et al., "Extended friction models for the physics simulation of servo actuators", 2024.
"""

import math

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import PRESLIDING, EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-(acceleration + load_factor |load|) sign(v)``; the load is what the drive bears.

    The pull of a position controller, ``-kp q``, is of the drive, though a simulator has it as a spring.
    """
    pull = theta[4] * (s + theta[5])
    return -math.copysign(theta[1] + theta[0] * abs(spring + pull - (drive - pull)), v)


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
    confusable_with=("coulomb_friction", "stribeck_friction", "hysteresis"),
    mujoco="the friction loss of a joint does not depend on the load that it carries.",
    title="friction that grows with load",
    what="A bearing or gear rubs more the harder it is pressed.",
    symptom="Losses differ between poses, or between weak and strong inputs, at equal speed.",
    remedy="Let the simulation's friction depend on the load that the joint carries.",
)
