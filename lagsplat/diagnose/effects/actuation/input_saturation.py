"""An actuator that gives no more than a limit: ``u = clip(u, -limit, limit)``."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal


def change(signal: Any, theta: Float64[np.ndarray, "P 1"]) -> Float64[np.ndarray, "P M"]:
    """The input, cut at the limit on both sides."""
    return np.clip(signal.values, -theta[:, :1], theta[:, :1])


EFFECT = InputEffect(
    name="input_saturation",
    group="C",
    component="actuation",
    level="actuation",
    equation="u = clip(u_logged, -limit, limit)",
    parameters=(EffectParameter("limit", "input", log_normal(1.0, 0.5), (0.4, 0.7, 1.0, 1.4, 2.0)),),
    needs="inputs on both sides of the limit",
    amplitudes=0,
    along="channels",
    together=True,
    change=change,
)
