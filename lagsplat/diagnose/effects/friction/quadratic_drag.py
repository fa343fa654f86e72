"""Drag that grows with the square of the speed: ``Q = -m coefficient |v| v``."""

from collections.abc import Mapping
from typing import Any

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-coefficient |v| v``."""
    return -theta[0] * abs(v) * v


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Raise the damping of the joint that grows with the square of the speed."""
    return element.raise_damping(1, values["coefficient"])


EFFECT = ForceEffect(
    name="quadratic_drag",
    group="B",
    number=4,
    component="dissipative",
    equation="a = -coefficient |v| v",
    parameters=(EffectParameter("coefficient", "per_coordinate", HalfNormal(0.2)),),
    needs="amplitudes that differ threefold",
    acts_everywhere=True,
    law=force,
    confusable_with=("viscous_damping",),
    mujoco=to_mujoco,
    title="drag of air or water",
    what="A resistance that grows with the square of speed.",
    symptom="Large swings die away quickly, small ones hardly at all.",
    remedy="Add a quadratic drag to the simulation.",
)
