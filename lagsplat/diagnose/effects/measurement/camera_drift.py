"""A camera that moves slowly: what is seen walks away by ``rate`` a second."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import ObservationEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def observe(y: Any, v: Any, t: Any, theta: Float64[np.ndarray, "P 1"], instance: PlacedEffect) -> Any:
    """``y + rate t`` along the direction."""
    along = instance.direction
    assert along is not None
    p = along.covector
    return y + (theta[:, 0, None, None] * t)[..., None] * (p / (p @ p))


EFFECT = ObservationEffect(
    name="camera_drift",
    group="G",
    level="chart",
    equation="y = q + rate t",
    parameters=(EffectParameter("rate", "drift", Normal(0.2)),),
    needs="a background that stands still, or the same motion early and late",
    observe=observe,
)
