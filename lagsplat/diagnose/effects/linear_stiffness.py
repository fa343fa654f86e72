"""A potential that is steeper or flatter than the sim's: ``V -> ratio V``, or along one coordinate."""

import math
from dataclasses import replace
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.effect import Fields, Force, Parameter
from lagsplat.diagnose.kernel import law
from lagsplat.diagnose.prior import Normal


@law
@no_type_check
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``(ratio - 1)`` times the conservative force of the sim."""
    return (math.exp(theta[0]) - 1.0) * spring


def whole(fields: Fields, theta: Float64[np.ndarray, "P 1"], model: Any) -> Fields:
    """The potential times ``ratio``."""
    return replace(fields, potential=fields.potential * np.exp(theta[:, :1]))


EFFECT = Force(
    name="linear_stiffness",
    group="A",
    component="conservative",
    equation="V = ratio V_sim",
    parameters=(Parameter("ratio", "log_ratio", Normal(0.3)),),
    needs="free motion, or a static hold under a known input",
    along="both",
    law=force,
    whole=whole,
)
