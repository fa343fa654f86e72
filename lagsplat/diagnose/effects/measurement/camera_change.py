"""A camera that was moved or zoomed: the coordinates appear shifted and stretched."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.data_quality.excitation_measures import ExcitationMeasures
from lagsplat.diagnose.effects.base import Grade, ObservationEffect, PlacedEffect
from lagsplat.diagnose.effects.excitation import make_grade
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def observe(y: Any, v: Any, t: Any, theta: Float64[np.ndarray, "P 2"], placed: PlacedEffect) -> Any:
    """Return ``y + zoom (y - rest) + shift`` along the direction."""
    along = placed.direction
    assert along is not None
    s = y @ along.covector - along.rest
    return along.shift(y, theta[:, 0, None, None] * s + theta[:, 1, None, None])


def grade_excitation(measures: ExcitationMeasures) -> Grade:
    """Trajectories alone hardly show it: only a nonlinear law tells a scale."""
    weak = measures.periods > 3 and (measures.amplitude_ratio > 2.0 or measures.driven)
    reason = "without pictures only the curvature of the law tells a scale"
    return make_grade(False, weak, reason, "film a static background too, and give the video")


EFFECT = ObservationEffect(
    name="camera_change",
    number=4,
    equation="y = q + zoom (q - rest) + shift",
    parameters=(
        EffectParameter("zoom", "ratio", Normal(0.1)),
        EffectParameter("shift", "coordinate", Normal(0.1)),
    ),
    needs="a background that stands still",
    observe=observe,
    report_parameters=lambda p, placed: {"zoom": 1.0 + p["zoom"], "shift": p["shift"]},
    excitation=grade_excitation,
    confusable_with=("input_gain", "constant_force"),
    recorded_by="film",
    camera="moved between recordings",
    title="a camera that was moved or zoomed",
    kind="observation",
    what="The camera has another pose or zoom than in the video that the simulation was learnt from.",
    symptom="Everything appears shifted or stretched, at rest as well; the background is too.",
    remedy="Put the camera back or calibrate it; leave the simulation alone.",
)
