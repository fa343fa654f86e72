"""A degree of freedom that the sim lacks: a second mass on a spring, carried along."""

from typing import no_type_check

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``mass_ratio (omega^2 x + 2 zeta omega dx/dt)``, ``x`` from the first mass to the second."""
    omega = theta[1]
    pull = omega * omega * (memory[0] - s) + 2.0 * theta[2] * omega * (memory[1] - v)
    d_memory[0] = memory[1]
    d_memory[1] = -pull
    return theta[0] * pull


EFFECT = ForceEffect(
    name="hidden_mode",
    group="F",
    component="memory",
    equation="a = mass_ratio (omega^2 (s2 - s) + 2 damping_ratio omega (v2 - v)), s2'' minus the same",
    parameters=(
        EffectParameter("mass_ratio", "ratio", HalfNormal(0.15)),
        EffectParameter("angular_frequency", "rate", log_normal(2.0, 0.5), (0.7, 1.2, 1.6, 2.2, 3.0, 4.5)),
        EffectParameter("damping_ratio", "ratio", log_normal(0.03, 0.8), (0.03,)),
    ),
    needs="broadband motion up to twice its frequency",
    passive=True,
    law=force,
    n_memory=2,
    memory_start=("s", "v"),
    memory_kinds=("coordinate", "velocity"),
    reports=lambda p, instance: {
        "frequency_hz": p["angular_frequency"] / 6.283185307179586,
        "mass_ratio": p["mass_ratio"],
        "damping_ratio": p["damping_ratio"],
    },
)
