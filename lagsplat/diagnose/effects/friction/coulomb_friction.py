"""Coulomb friction: ``Q = -m acceleration sign(v)`` in motion; bristles hold what rests."""

from collections.abc import Mapping
from typing import Any

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import PRESLIDING, EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.dry_friction import resist_evenly


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Raise the friction loss of the joint."""
    joint = element.joint
    joint.frictionloss = float(joint.frictionloss) + values["acceleration"] * element.inertia
    return (f"joint {joint.name}: frictionloss {joint.frictionloss:.6g}",)


EFFECT = ForceEffect(
    name="coulomb_friction",
    group="B",
    number=1,
    component="dissipative",
    equation="a = -acceleration sign(v)",
    parameters=(EffectParameter("acceleration", "acceleration", HalfNormal(0.2)), *PRESLIDING),
    needs="a decay down to rest, or slow reversals",
    acts_everywhere=True,
    between_variants=("",),
    law=resist_evenly,
    dry=("",),
    confusable_with=("stribeck_friction", "load_dependent_friction", "hysteresis", "input_dead_zone"),
    mujoco=to_mujoco,
    title="dry friction",
    what="A rubbing contact resists with the same force at every speed, however slow.",
    symptom="Swings shrink by the same amount each time, and it stops short of its rest position.",
    remedy="Add Coulomb friction to the simulation, or look after the bearings and seals.",
    short_title="Coulomb friction",
)
