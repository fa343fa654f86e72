"""An actuator that gives more or less than the sim's: ``u_j -> ratio u_j``."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def change(signal: Any, theta: Float64[np.ndarray, "P 1"]) -> Float64[np.ndarray, "P M"]:
    """``ratio u``."""
    return np.exp(theta[:, :1]) * signal.values


EFFECT = InputEffect(
    name="input_gain",
    group="A",
    component="actuation",
    level="actuation",
    equation="u = ratio u_logged",
    parameters=(EffectParameter("ratio", "log_ratio", Normal(0.3)),),
    needs="the input logged, with free motion beside it",
    along="channels",
    together=True,
    change=change,
)
