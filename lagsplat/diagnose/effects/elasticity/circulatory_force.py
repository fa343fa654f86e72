"""Coupling of two coordinates with opposite signs: by position (circulatory) or by speed (gyroscopic).

Source: Merkin, "Introduction to the Theory of Stability", 1997, ch. 6, doi:10.1007/978-1-4612-4046-4.
"""

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, Scales
from lagsplat.diagnose.solvers.force_laws import compile_force_law

GYROSCOPIC = "gyroscopic"


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``coupling`` times position and speed of the other coordinate, one of which counts."""
    return theta[0] * (theta[1] * s + theta[2] * v)


def _constants(scales: Scales, variant: str) -> tuple[float, ...]:
    """Units of the couplings by position [1/s^2] and by speed [1/s], of which one is zero."""
    rate = scales.of("rate")
    return (0.0, rate) if variant == GYROSCOPIC else (rate * rate, 0.0)


EFFECT = ForceEffect(
    name="circulatory_force",
    group="F",
    number=2,
    component="conservative",
    equation="a_1 = coupling s_2, a_2 = -coupling s_1; gyroscopic: v in place of s",
    parameters=(EffectParameter("coupling", "ratio", Normal(0.2)),),
    needs="free motion of both coordinates from several starts",
    variants=("", GYROSCOPIC),
    variant_units={"": "1/s^2", GYROSCOPIC: "1/s"},
    along="pairs",
    law=force,
    crosswise=True,
    constants=_constants,
    # a gyroscopic force does no work
    report_parameters=lambda p, placed: {
        "coupling": p["coupling"] * sum(_constants(placed.scales, placed.variant))
    },
    confusable_with=("linear_stiffness", "viscous_damping"),
    mujoco="springs and dampers of joints act on both coordinates alike.",
    title="a force across two coordinates",
    what="One coordinate pushes another, which answers the other way: a follower load, a spinning rotor.",
    symptom="Motion turns from one coordinate into the other, and may grow by itself.",
    remedy="Give the simulation the follower force or the spin that couples the two.",
)
