"""A zero that drifts, as with a camera that sinks: all coordinates shift by ``rate`` a second."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.data_quality.excitation_measures import ExcitationMeasures
from lagsplat.diagnose.effects.base import Grade, ObservationEffect, PlacedEffect
from lagsplat.diagnose.effects.excitation import make_grade
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def observe(y: Any, v: Any, t: Any, theta: Float64[np.ndarray, "P 1"], placed: PlacedEffect) -> Any:
    """Return ``y + rate t`` along the direction."""
    assert placed.direction is not None
    return placed.direction.shift(y, theta[:, 0, None, None] * t)


def grade_excitation(measures: ExcitationMeasures) -> Grade:
    """Trajectories alone never show it well: a drift of the rest looks the same."""
    reason = f"{measures.periods:.3g} periods; a drift of the rest looks the same"
    return make_grade(False, measures.periods > 8, reason, "record a reference that stands still too")


EFFECT = ObservationEffect(
    name="camera_drift",
    number=5,
    equation="y = q + rate t",
    parameters=(EffectParameter("rate", "drift", Normal(0.2)),),
    needs="a reference that stands still, or the same motion early and late",
    observe=observe,
    excitation=grade_excitation,
    confusable_with=("parameter_drift",),
    camera="moves while recording",
    title="a zero of the sensor that drifts",
    what="The sensor or its mount moves while the recording lasts.",
    symptom="The rest position wanders, and so does whatever stands still beside it.",
    remedy="Fix the sensor, or subtract what its reference drifts; leave the simulation alone.",
    short_title="drift of the sensor",
)
