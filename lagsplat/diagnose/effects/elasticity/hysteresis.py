"""Rate-independent hysteresis by the Bouc-Wen law.

Source: Ikhouane and Rodellar, "Systems with Hysteresis", 2007, doi:10.1002/9780470513200.
"""

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-acceleration z`` with ``dz/dt = v (1 - |z|^exponent (1 + sign(v z)) / 2) / displacement``."""
    z = min(max(memory[0], -1.0), 1.0)  # a step that is long for the displacement overshoots
    d_memory[0] = v * (1.0 - abs(z) ** theta[2] if v * z > 0.0 else 1.0) / theta[1]
    return -theta[0] * z


EFFECT = ForceEffect(
    name="hysteresis",
    group="D",
    number=1,
    component="memory",
    equation="a = -acceleration z, displacement dz/dt = v (1 - |z|^exponent (1 + sign(v z)) / 2)",
    parameters=(
        EffectParameter("acceleration", "acceleration", HalfNormal(0.3)),
        EffectParameter("displacement", "coordinate", log_normal(0.4, 0.8), (0.15, 0.4, 1.0)),
        EffectParameter("exponent", "ratio", log_normal(1.5, 0.5), (1.5,)),
    ),
    needs="slow cycles at three amplitudes",
    law=force,
    memory_start=("zero",),
    confusable_with=("coulomb_friction", "stribeck_friction", "load_dependent_friction"),
    mujoco="springs of joints have no internal state.",
    title="hysteresis",
    what="The force depends on the way by which a position was reached, not on speed.",
    symptom="Loading and unloading follow two curves, however slowly it is done.",
    remedy="Add an internal state of Bouc-Wen type to the simulation.",
)
