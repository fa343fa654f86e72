"""A constant force: tilt, preload, an offset of an actuator."""

from collections.abc import Mapping
from typing import Any

from numpy.polynomial import Polynomial

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``acceleration``."""
    return theta[0]


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
    confusable_with=("camera_change", "input_gain"),
    mujoco=to_mujoco,
    title="a constant force or a tilt",
    kind="parameter",
    what="A steady pull unknown to the simulation: a tilted base, a preload, an offset of an actuator.",
    symptom="The mechanism comes to rest somewhere else than predicted.",
    remedy="Level the base, take out the offset, or add it to the simulation.",
)
