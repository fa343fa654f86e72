"""A periodic disturbance at a frequency of its own, also while the mechanism rests."""

import math
from dataclasses import replace
from typing import no_type_check

from lagsplat.diagnose.effects.base import Effect, ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, Scales, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``cosine cos(omega t) + sine sin(omega t)``."""
    return theta[0] * math.cos(theta[2] * t) + theta[1] * math.sin(theta[2] * t)


def repeating(effect: Effect, scales: Scales) -> Effect:
    """The effect with a period of at most the recording's length: a part of a wave is a drift."""
    slowest = math.log(2.0 * math.pi / scales.duration_s / scales.of("rate"))
    known = effect.parameters
    bounded = tuple(
        replace(p, prior=replace(p.prior, lowest=slowest)) if p.name == "angular_frequency" else p
        for p in known
    )
    return replace(effect, parameters=bounded)


EFFECT = ForceEffect(
    name="external_periodic_force",
    group="E",
    component="exogenous",
    equation="a = acceleration cos(2 pi frequency t + phase)",
    parameters=(
        EffectParameter("cosine", "acceleration", Normal(0.2)),
        EffectParameter("sine", "acceleration", Normal(0.2)),
        EffectParameter("angular_frequency", "rate", log_normal(1.0, 1.0), (0.5, 1.0, 1.5, 2.0, 3.0)),
    ),
    needs="a stretch at rest of ten cycles",
    amplitudes=2,
    law=force,
    reports=lambda p, instance: {
        "frequency_hz": p["angular_frequency"] / (2.0 * math.pi),
        "acceleration": math.hypot(p["cosine"], p["sine"]),
    },
)
