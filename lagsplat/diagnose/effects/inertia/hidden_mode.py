"""A degree of freedom that the simulation lacks: a second mass on a spring that is carried along."""

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``mass_ratio (omega^2 x + 2 zeta omega dx/dt)``, ``x`` from the first mass to the second."""
    omega = theta[1]
    pull = omega * omega * (memory[0] - s) + 2.0 * theta[2] * omega * (memory[1] - v)
    d_memory[0] = memory[1]
    d_memory[1] = -pull
    return theta[0] * pull


EFFECT = ForceEffect(
    name="hidden_mode",
    group="F",
    number=1,
    component="memory",
    equation="a = mass_ratio (omega^2 (s2 - s) + 2 damping_ratio omega (v2 - v)), s2'' minus the same",
    parameters=(
        EffectParameter("mass_ratio", "ratio", HalfNormal(0.15)),
        EffectParameter("angular_frequency", "rate", log_normal(2.0, 0.5), (0.7, 1.2, 1.6, 2.2, 3.0, 4.5)),
        EffectParameter("damping_ratio", "ratio", log_normal(0.03, 0.8), (0.03,)),
    ),
    needs="broadband motion up to twice its frequency",
    law=force,
    memory_start=("s", "v"),
    report_parameters=lambda p, placed: {
        "frequency_hz": p["angular_frequency"] / 6.283185307179586,
        "mass_ratio": p["mass_ratio"],
        "damping_ratio": p["damping_ratio"],
    },
    confusable_with=("external_periodic_force", "mass_change"),
    flexible=True,
    mujoco="it would need another body, whose place and axis a generalised coordinate does not tell.",
    title="a part that swings along and that the simulation does not have",
    what="A loose or flexible part moves on its own and pulls on the rest.",
    symptom="A second frequency appears, and energy leaves and comes back.",
    remedy="Give the simulation one more coordinate, or fasten the part.",
)
