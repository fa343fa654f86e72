"""Rate-independent hysteresis by the Bouc-Wen law (Dahl's, at this exponent).

Source: Ikhouane and Rodellar, "Systems with Hysteresis", 2007, doi:10.1002/9780470513200.
"""

from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-acceleration z`` with ``dz/dt = (v - |v| z / 2 - v |z| / 2) / displacement``."""
    z = memory[0]
    d_memory[0] = (v - 0.5 * abs(v) * z - 0.5 * v * abs(z)) / theta[1]
    return -theta[0] * z


EFFECT = ForceEffect(
    name="hysteresis",
    group="D",
    component="memory",
    equation="a = -acceleration z, displacement dz/dt = v - |v| z / 2 - v |z| / 2",
    parameters=(
        EffectParameter("acceleration", "acceleration", HalfNormal(0.3)),
        EffectParameter("displacement", "coordinate", log_normal(0.4, 0.8), (0.15, 0.4, 1.0)),
    ),
    needs="slow cycles at three amplitudes",
    law=force,
    n_memory=1,
    memory_start=("zero",),
)
