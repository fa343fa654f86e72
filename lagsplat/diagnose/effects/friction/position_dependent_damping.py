"""Damping that is stronger about one place: ``Q = -m rate v / (1 + ((s - place) / width)^2)``."""

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, Normal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-rate v`` at ``place``, and half of it ``width`` away."""
    x = (s - theta[1]) / theta[2]
    return -theta[0] * v / (1.0 + x * x)


EFFECT = ForceEffect(
    name="position_dependent_damping",
    group="B",
    number=5,
    component="dissipative",
    equation="a = -rate v / (1 + ((s - place) / width)^2)",
    parameters=(
        EffectParameter("rate", "rate", HalfNormal(0.4)),
        EffectParameter("place", "coordinate", Normal(1.0), (-1.5, -0.7, 0.0, 0.7, 1.5)),
        EffectParameter("width", "coordinate", log_normal(0.6, 0.6), (0.4, 1.0)),
    ),
    needs="every position passed at several speeds",
    law=force,
    confusable_with=("viscous_damping", "quadratic_drag"),
    mujoco="the damping of a joint does not depend on its position.",
    title="damping that depends on the position",
    what="Some part of the travel is tighter than the rest: a bent guide, a worn or a dry spot.",
    symptom="Energy is lost wherever that place is passed, and hardly elsewhere.",
    remedy="Let the simulation's damping depend on the position, or look at the guide there.",
)
