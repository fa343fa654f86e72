"""A push that nobody logged: a constant force for a while."""

import math
from typing import no_type_check

from lagsplat.diagnose.effects.effect import Force, Normal, Parameter, about
from lagsplat.diagnose.kernel import law


@law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``acceleration`` from half a ``duration`` before ``time`` to half after, with edges of a frame."""
    x = (0.5 * theta[2] - abs(t - theta[1])) / theta[3]
    return 0.0 if x < -30.0 else theta[0] / (1.0 + math.exp(-x))


EFFECT = Force(
    name="external_push",
    group="E",
    equation="a = acceleration for a duration about a time",
    parameters=(
        Parameter("acceleration", "acceleration", Normal(1.0)),
        Parameter("time", "time", Normal(100.0), (1.0,)),
        Parameter("duration", "time", about(1.0, 0.8), (1.0,)),
    ),
    needs="a stretch in which nothing else moves it",
    law=force,
    constants=lambda scales, variant: (scales.frame_s,),
    reports=lambda p: {"times": [p["time"]], "accelerations": [p["acceleration"]]},
)
