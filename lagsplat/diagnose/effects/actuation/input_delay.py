"""An input that arrives late as a whole: ``u(t) = u_logged(t - delay)``."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal


def change(signal: Any, theta: Float64[np.ndarray, "P 1"]) -> Float64[np.ndarray, "P M"]:
    """The input as it was ``delay`` ago; before the first sample of a clip, that sample."""
    return np.stack([signal.at(signal.time - delay) for delay in theta[:, 0]])


EFFECT = InputEffect(
    name="input_delay",
    group="C",
    component="actuation",
    level="actuation",
    equation="u(t) = u_logged(t - delay)",
    parameters=(EffectParameter("delay", "time", log_normal(0.3, 1.0), (0.05, 0.2, 0.6, 1.2)),),
    needs="an input with steps, and an event that starts without it",
    amplitudes=0,
    along="channels",
    together=True,
    change=change,
)
