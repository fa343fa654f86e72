"""A spring that hardens or softens: ``Q = -m coefficient s^3``."""

from collections.abc import Mapping
from typing import Any

from numpy.polynomial import Polynomial

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-coefficient s^3``."""
    return -theta[0] * s * s * s


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Add a cubic term to the spring of the joint."""
    stretch = Polynomial([-element.rest, 1.0])
    return element.add_spring(values["coefficient"] * element.inertia * stretch**3)


EFFECT = ForceEffect(
    name="cubic_stiffness",
    group="A",
    number=6,
    component="conservative",
    equation="a = -coefficient s^3",
    parameters=(EffectParameter("coefficient", "cubic", Normal(0.3)),),
    needs="two amplitudes, one at least twice the other",
    law=force,
    confusable_with=("end_stop",),
    mujoco=to_mujoco,
    title="a spring that hardens or softens",
    kind="parameter",
    what="The pull back to rest grows faster, or slower, than the deflection.",
    symptom="The frequency depends on how far it swings, while small swings are predicted well.",
    remedy="Give the simulation's potential a term of fourth order.",
)
