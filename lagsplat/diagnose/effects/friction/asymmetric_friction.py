"""Friction that differs between both directions, dry or viscous."""

import math
from collections.abc import Mapping

from lagsplat.diagnose.effects.base import ForceEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import PRESLIDING, EffectParameter, HalfNormal, Scales
from lagsplat.diagnose.solvers.force_laws import compile_force_law

VISCOUS = "viscous"


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-forward`` or ``backward`` by the sign of ``v``, times that or the speed."""
    shape = v * theta[4] if theta[4] > 0.0 else math.copysign(1.0, v)
    return -(theta[0] if v > 0.0 else theta[1]) * shape


def _constants(scales: Scales, variant: str) -> tuple[float, ...]:
    """What makes a speed a share of the rms, or zero for dry friction."""
    return (1.0 / scales.velocity if variant == VISCOUS else 0.0,)


def _report_parameters(p: Mapping[str, float], placed: PlacedEffect) -> dict[str, float]:
    """Viscous friction per second, without what only dry friction has."""
    if placed.variant != VISCOUS:
        return dict(p)
    return {name: p[name] / placed.scales.velocity for name in ("forward", "backward")}


EFFECT = ForceEffect(
    name="asymmetric_friction",
    group="B",
    number=6,
    component="dissipative",
    equation="a = -forward sign(v) for v > 0, -backward sign(v) for v < 0; viscous: v in place of sign(v)",
    parameters=(
        EffectParameter("forward", "acceleration", HalfNormal(0.2)),
        EffectParameter("backward", "acceleration", HalfNormal(0.2)),
        *PRESLIDING,
    ),
    needs="motion in both directions at several speeds",
    variants=("", VISCOUS),
    variant_units={VISCOUS: "1/s"},
    law=force,
    constants=_constants,
    dry=("",),
    report_parameters=_report_parameters,
    confusable_with=("coulomb_friction", "viscous_damping", "constant_force"),
    mujoco="friction loss and damping of a joint are the same in both directions.",
    title="friction that differs between both directions",
    what="A lip seal, a ratchet or a valve resists more in one direction than in the other.",
    symptom="Half-swings in one direction lose more than those in the other, and the mean is pushed aside.",
    remedy="Give the simulation friction of its own for each direction.",
)
