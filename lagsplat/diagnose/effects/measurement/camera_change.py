"""A lens or pose that changed: the coordinates are seen shifted and stretched."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import ObservationEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def observe(y: Any, v: Any, t: Any, theta: Float64[np.ndarray, "P 2"], instance: PlacedEffect) -> Any:
    """``y + zoom (y - rest) + shift`` along the direction."""
    along = instance.direction
    assert along is not None
    p = along.covector
    s = y @ p - along.rest
    move = theta[:, 0, None, None] * s + theta[:, 1, None, None]
    return y + move[..., None] * (p / (p @ p))


EFFECT = ObservationEffect(
    name="camera_change",
    group="G",
    level="chart",
    equation="y = q + zoom (q - rest) + shift",
    parameters=(
        EffectParameter("zoom", "ratio", Normal(0.1)),
        EffectParameter("shift", "coordinate", Normal(0.1)),
    ),
    needs="a background that stands still",
    amplitudes=2,
    observe=observe,
    reports=lambda p, instance: {"zoom": 1.0 + p["zoom"], "shift": p["shift"]},
)
