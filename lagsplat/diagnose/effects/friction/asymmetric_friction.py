"""Friction that differs between both directions, dry or viscous."""

import math

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.excitation import ask_for_decay, describe_reversals, make_grade
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, Scales
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law

VISCOUS = "viscous"


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-forward`` or ``backward`` by the sign of ``v``, times a smooth step or the speed."""
    shape = v * theta[3] if theta[3] > 0.0 else math.tanh(v / theta[2])
    return -(theta[0] if v > 0.0 else theta[1]) * shape


def _constants(scales: Scales, variant: str) -> tuple[float, ...]:
    """Speed over which dry friction is smooth, and what makes a speed a share of the rms, or zero."""
    return (0.02 * scales.velocity, 1.0 / scales.velocity if variant == VISCOUS else 0.0)


EFFECT = ForceEffect(
    name="asymmetric_friction",
    group="B",
    number=6,
    component="dissipative",
    equation="a = -forward sign(v) for v > 0, -backward sign(v) for v < 0; viscous: v in place of sign(v)",
    parameters=(
        EffectParameter("forward", "acceleration", HalfNormal(0.2)),
        EffectParameter("backward", "acceleration", HalfNormal(0.2)),
    ),
    needs="motion in both directions at several speeds",
    excitation=lambda m: make_grade(
        m.reversals >= 8 and m.amplitude_ratio > 1.8,
        m.reversals >= 4,
        describe_reversals(m),
        ask_for_decay(m),
    ),
    variants=("", VISCOUS),
    variant_units={VISCOUS: "1/s"},
    law=force,
    constants=_constants,
    passive=True,
    report_parameters=lambda p, placed: {
        name: value * (_constants(placed.scales, placed.variant)[1] or 1.0) for name, value in p.items()
    },
    confusable_with=("coulomb_friction", "viscous_damping", "constant_force"),
    mujoco="friction loss and damping of a joint are the same in both directions.",
    title="friction that differs between both directions",
    what="A lip seal, a ratchet or a valve resists more in one direction than in the other.",
    symptom="Half-swings in one direction lose more than those in the other, and the mean is pushed aside.",
    remedy="Give the simulation friction of its own for each direction.",
)
