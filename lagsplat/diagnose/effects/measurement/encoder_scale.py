"""A sensor of one coordinate whose scale or zero is off: another count, length or mounting."""

from lagsplat.diagnose.effects.base import ObservationEffect
from lagsplat.diagnose.effects.measurement.camera_change import observe
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal

EFFECT = ObservationEffect(
    name="encoder_scale",
    number=7,
    level="perception",
    equation="y = q + (scale - 1) (q - rest) + offset",
    parameters=(
        EffectParameter("scale", "ratio", Normal(0.1)),
        EffectParameter("offset", "coordinate", Normal(0.1)),
    ),
    needs_all_forces=True,
    needs="two positions that are known from elsewhere",
    observe=observe,
    report_parameters=lambda p, placed: {"scale": 1.0 + p["scale"], "offset": p["offset"]},
    confusable_with=("input_gain", "constant_force", "mass_change"),
    recorded_by="log",
    title="a sensor whose scale or zero is off",
    what="The encoder counts more or less to the turn than assumed, or its zero lies elsewhere.",
    symptom="One coordinate appears stretched or shifted, at rest as well.",
    remedy="Calibrate the sensor against two known positions; leave the simulation alone.",
)
