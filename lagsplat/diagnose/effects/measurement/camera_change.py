"""A sensor with another zero or scale, as a camera that was moved: coordinates are shifted and stretched."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import ObservationEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def observe(y: Any, v: Any, t: Any, theta: Float64[np.ndarray, "P 2"], placed: PlacedEffect) -> Any:
    """Return ``y + zoom (y - rest) + shift`` along the direction."""
    along = placed.direction
    assert along is not None
    s = y @ along.covector - along.rest
    return along.shift(y, theta[:, 0, None, None] * s + theta[:, 1, None, None])


EFFECT = ObservationEffect(
    name="camera_change",
    number=4,
    equation="y = q + zoom (q - rest) + shift",
    parameters=(
        EffectParameter("zoom", "ratio", Normal(0.1)),
        EffectParameter("shift", "coordinate", Normal(0.1)),
    ),
    needs="a reference that stands still",
    observe=observe,
    report_parameters=lambda p, placed: {"zoom": 1.0 + p["zoom"], "shift": p["shift"]},
    confusable_with=("input_gain", "constant_force"),
    recorded_by="film",
    camera="moved between recordings",
    title="a sensor with another zero or scale",
    what="Positions are read with another zero or scale than the simulation was made with.",
    symptom="Everything appears shifted or stretched, at rest as well.",
    remedy="Set the zero and scale of the sensor anew; leave the simulation alone.",
    short_title="zero or scale of the sensor",
)
