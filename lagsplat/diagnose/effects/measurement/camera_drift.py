"""A zero that drifts, as with a camera that sinks: all coordinates shift by ``rate`` a second."""

from lagsplat.diagnose.effects.base import ObservationEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal

EFFECT = ObservationEffect(
    name="camera_drift",
    number=5,
    equation="y = q + rate t",
    parameters=(EffectParameter("rate", "drift", Normal(0.2)),),
    needs="a reference that stands still, or the same motion early and late",
    observe=lambda y, v, t, theta, placed: placed.direction.shift(y, theta[:, 0, None, None] * t),
    confusable_with=("parameter_drift",),
    camera="moves while recording",
    title="a zero of the sensor that drifts",
    what="The sensor or its mount moves while the recording lasts.",
    symptom="The rest position wanders, and so does whatever stands still beside it.",
    remedy="Fix the sensor, or subtract what its reference drifts; leave the simulation alone.",
    short_title="drift of the sensor",
)
