"""A valve or gear that ignores small inputs: ``u = sign(u) max(|u| - half_width, 0)``."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal


def change(signal: Any, theta: Float64[np.ndarray, "P 1"]) -> Float64[np.ndarray, "P M"]:
    """What is left of the input beyond the dead zone."""
    u = signal.values
    return np.sign(u) * np.maximum(np.abs(u) - np.abs(theta[:, :1]), 0.0)


EFFECT = InputEffect(
    name="input_dead_zone",
    group="C",
    component="actuation",
    level="actuation",
    equation="u = sign(u_logged) max(|u_logged| - half_width, 0)",
    parameters=(EffectParameter("half_width", "input", log_normal(0.3, 1.0), (0.05, 0.2, 0.5, 1.0)),),
    needs="slow, small inputs through zero",
    amplitudes=0,
    along="channels",
    together=True,
    change=change,
)
