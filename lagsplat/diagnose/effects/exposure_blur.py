"""A long exposure: what is seen is the mean over it, so that fast motion looks smaller."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.effect import HalfNormal, Instance, Observation, Parameter


def observe(y: Any, v: Any, t: Any, theta: Float64[np.ndarray, "P 1"], instance: Instance) -> Any:
    """``y + exposure^2 / 24 d^2y/dt^2``, to second order in the exposure."""
    step = np.gradient(t, axis=1)
    # beyond a window's end its last instant stands
    bend = np.gradient(v, axis=2) / np.where(step > 0.0, step, np.inf)[None, :, :, None]
    return y + theta[:, 0, None, None, None] ** 2 / 24.0 * bend


EFFECT = Observation(
    name="exposure_blur",
    group="G",
    level="chart",
    equation="y = mean of q over the exposure",
    parameters=(Parameter("exposure", "frame", HalfNormal(1.0)),),
    needs="motion within one exposure, seen in the pictures",
    along="whole",
    observe=observe,
)
