"""Clocks of motion and inputs that disagree: ``u(t) = u_logged(t + offset)`` for every input at once.

Motion that is stamped late, a negative offset, cannot be told from a delay of every input.
"""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def change(signal: Any, theta: Float64[np.ndarray, "P 1"]) -> Float64[np.ndarray, "P M"]:
    """The input as it will be in ``offset``, or was."""
    return np.stack([signal.at(signal.time + offset) for offset in theta[:, 0]])


EFFECT = InputEffect(
    name="time_offset",
    group="G",
    level="perception",
    equation="y(t) = q(t + offset)",
    parameters=(
        EffectParameter("offset", "time", Normal(0.5), (-1.2, -0.6, -0.2, -0.05, 0.05, 0.2, 0.6, 1.2)),
    ),
    needs="an input with steps, and an event that starts without it",
    amplitudes=0,
    along="whole",
    change=change,
)
