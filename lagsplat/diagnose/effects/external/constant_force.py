"""A constant force: tilt, preload, an offset of an actuator."""

from collections.abc import Mapping
from typing import Any

from numpy.polynomial import Polynomial

from lagsplat.diagnose.data_quality.excitation_measures import ExcitationMeasures
from lagsplat.diagnose.effects.base import ForceEffect, Grade
from lagsplat.diagnose.effects.excitation import ask_for_decay, make_grade
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``acceleration``."""
    return theta[0]


def grade_excitation(measures: ExcitationMeasures) -> Grade:
    """It shows as a shifted rest position."""
    rest = f", and at rest for {measures.rest_periods:.2g}" if measures.rest_periods else ""
    reason = f"{measures.periods:.3g} periods about one middle{rest}"
    yes = measures.rest_periods > 0.5 or measures.periods > 5
    return make_grade(yes, measures.periods > 2, reason, ask_for_decay(measures))


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Shift where the spring of the joint is slack; a joint without a spring gets a very weak one."""
    return element.add_spring(Polynomial([-values["acceleration"] * element.inertia]))


EFFECT = ForceEffect(
    name="constant_force",
    group="A",
    number=4,
    component="conservative",
    equation="a = acceleration",
    parameters=(EffectParameter("acceleration", "acceleration", Normal(0.3)),),
    needs="a stretch at rest",
    acts_everywhere=True,
    law=force,
    excitation=grade_excitation,
    confusable_with=("camera_change", "input_gain"),
    mujoco=to_mujoco,
    title="a constant force or a tilt",
    kind="parameter",
    what="A steady pull unknown to the simulation: a tilted base, a preload, an offset of an actuator.",
    symptom="The mechanism comes to rest somewhere else than predicted.",
    remedy="Level the base, take out the offset, or add it to the simulation.",
)
