"""A sensor that averages, as a long exposure does: a sample is a mean, so that fast motion looks smaller."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import ObservationEffect, PlacedEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal


def observe(y: Any, v: Any, t: Any, theta: Float64[np.ndarray, "P 1"], placed: PlacedEffect) -> Any:
    """Return ``y + exposure^2 / 24 d^2y/dt^2``, to second order in the exposure.

    Padding after the end of a window repeats its last time; no difference is taken across it.
    """
    gap = np.diff(t, axis=1)
    real = gap > 0.0
    slope = np.diff(v, axis=2) * (real / np.where(real, gap, 1.0))[None, :, :, None]
    total = np.zeros_like(v)
    total[:, :, :-1] += slope
    total[:, :, 1:] += slope
    count = np.zeros(t.shape)
    count[:, :-1] += real
    count[:, 1:] += real
    second = total / np.maximum(count, 1.0)[None, :, :, None]
    return y + theta[:, 0, None, None, None] ** 2 / 24.0 * second


EFFECT = ObservationEffect(
    name="exposure_blur",
    number=6,
    equation="y = mean of q over some time",
    parameters=(EffectParameter("exposure", "frame", HalfNormal(1.0)),),
    needs="motion within one sample, and known of the sensor",
    along="whole",
    observe=observe,
    camera="shutter",
    title="a sensor that averages over time",
    what="Each sample is a mean over some time, such as that of a filter.",
    symptom="Fast turns look smaller than they are.",
    remedy="Shorten that time; leave the simulation alone.",
    short_title="averaging sensor",
)
