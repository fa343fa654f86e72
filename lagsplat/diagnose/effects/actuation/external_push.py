"""Pushes that nobody logged: a constant force for a while, up to three times."""

import math
from collections.abc import Mapping
from typing import Any, no_type_check

from lagsplat.diagnose.effects.base import ForceEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, log_normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law

N_PUSHES = 3


@compile_force_law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``acceleration`` from half a ``duration`` before each ``time`` to half after, with edges of a frame."""
    total = 0.0
    for n in range(3):
        x = (0.5 * theta[6 + n] - abs(t - theta[3 + n])) / theta[9]
        if x > -30.0:
            total += theta[n] / (1.0 + math.exp(-x))
    return total


def _told(parameters: Mapping[str, float], instance: PlacedEffect) -> dict[str, Any]:
    """Pushes that are there at all, in the order of time."""
    strongest = max(abs(parameters[f"acceleration {n}"]) for n in range(N_PUSHES))
    rows = sorted(
        (parameters[f"time {n}"], parameters[f"acceleration {n}"])
        for n in range(N_PUSHES)
        if abs(parameters[f"acceleration {n}"]) > 0.1 * strongest
    )
    return {"times": [time for time, _ in rows], "accelerations": [a for _, a in rows]}


EFFECT = ForceEffect(
    name="external_push",
    group="E",
    component="exogenous",
    equation="a = acceleration for a duration about a time, up to three times",
    parameters=(
        *(EffectParameter(f"acceleration {n}", "acceleration", Normal(1.0)) for n in range(N_PUSHES)),
        *(EffectParameter(f"time {n}", "time", Normal(1000.0), (1.0,)) for n in range(N_PUSHES)),
        *(EffectParameter(f"duration {n}", "time", log_normal(1.0, 0.8), (1.0,)) for n in range(N_PUSHES)),
    ),
    needs="a stretch in which nothing else moves it",
    amplitudes=N_PUSHES,
    law=force,
    constants=lambda scales, variant: (scales.frame_s,),
    reports=_told,
)
