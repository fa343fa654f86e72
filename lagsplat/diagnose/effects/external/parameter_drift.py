"""A parameter that changes slowly: the stiffness, or a load, by ``rate`` a second and a quadratic term."""

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, Scales
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``rate t + bend t^2 / duration`` times the conservative force or the unit of acceleration."""
    return (theta[0] + theta[1] * t / theta[3]) * t * (spring if theta[2] == 0.0 else theta[2])


def _constants(scales: Scales, variant: str) -> tuple[float, ...]:
    return (0.0 if variant == "" else scales.of("acceleration"), scales.duration_s)


EFFECT = ForceEffect(
    name="parameter_drift",
    group="E",
    number=4,
    component="exogenous",
    equation="V = (1 + rate t + bend t^2 / duration) V_sim, or a likewise",
    parameters=(
        EffectParameter("rate", "per_duration", Normal(0.15)),
        EffectParameter("bend", "per_duration", Normal(0.05)),
    ),
    needs="the same motion early and late",
    variants=("", "load"),
    variant_units={"load": "{q}/s^3"},
    law=force,
    constants=_constants,
    report_parameters=lambda p, placed: {
        "rate": p["rate"] * (_constants(placed.scales, placed.variant)[0] or 1.0)
    },
    confusable_with=("creep", "viscous_damping", "linear_stiffness", "camera_drift"),
    mujoco="parameters of a model do not depend on time.",
    title="a property that changes slowly",
    kind="outside",
    what="Something warms up, wears or leaks while the recording lasts.",
    symptom="The simulation fits early and fails late, for the same motion.",
    remedy="Record after warming up, or let that parameter depend on time.",
)
