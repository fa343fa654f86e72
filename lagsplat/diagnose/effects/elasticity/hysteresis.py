"""Rate-independent hysteresis by the Bouc-Wen law (Dahl's, at this exponent).

Source: Ikhouane and Rodellar, "Systems with Hysteresis", 2007, doi:10.1002/9780470513200.
"""

from lagsplat.diagnose.data_quality.excitation_measures import ExcitationMeasures
from lagsplat.diagnose.effects.base import ForceEffect, Grade
from lagsplat.diagnose.effects.excitation import describe_reversals, make_grade
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-acceleration z`` with ``dz/dt = (v - |v| z / 2 - v |z| / 2) / displacement``."""
    z = memory[0]
    d_memory[0] = (v - 0.5 * abs(v) * z - 0.5 * v * abs(z)) / theta[1]
    return -theta[0] * z


def grade_excitation(measures: ExcitationMeasures) -> Grade:
    """It shows as a loop of force over position that does not depend on speed."""
    slow = measures.driven and any(channel.low < 0.4 for channel in measures.inputs)
    reason = describe_reversals(measures) + (", slow inputs among them" if slow else "")
    yes = measures.reversals >= 8 and measures.amplitude_ratio > 2.0
    record = f"record slow cycles at three amplitudes and two speeds, {20 * measures.period_s:.3g} s"
    return make_grade(yes, measures.reversals >= 6, reason, record)


EFFECT = ForceEffect(
    name="hysteresis",
    group="D",
    number=1,
    component="memory",
    equation="a = -acceleration z, displacement dz/dt = v - |v| z / 2 - v |z| / 2",
    parameters=(
        EffectParameter("acceleration", "acceleration", HalfNormal(0.3)),
        EffectParameter("displacement", "coordinate", log_normal(0.4, 0.8), (0.15, 0.4, 1.0)),
    ),
    needs="slow cycles at three amplitudes",
    law=force,
    memory_start=("zero",),
    excitation=grade_excitation,
    confusable_with=("coulomb_friction", "stribeck_friction", "load_dependent_friction"),
    mujoco="springs of joints have no internal state.",
    title="hysteresis",
    what="The force depends on the way by which a position was reached, not on speed.",
    symptom="Loading and unloading follow two curves, however slowly it is done.",
    remedy="Add an internal state of Bouc-Wen type to the simulation.",
)
