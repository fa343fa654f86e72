"""A valve or gear that ignores small inputs: ``u = sign(u) max(|u| - half_width, 0)``."""

import numpy as np

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal

EFFECT = InputEffect(
    name="input_dead_zone",
    group="C",
    number=3,
    equation="u = sign(u_logged) max(|u_logged| - half_width, 0)",
    parameters=(EffectParameter("half_width", "input", log_normal(0.3, 1.0), (0.05, 0.2, 0.5, 1.0)),),
    needs="slow, small inputs through zero",
    acts_everywhere=True,
    change=lambda signal, theta: (
        np.sign(signal.values) * np.maximum(np.abs(signal.values) - np.abs(theta[:, :1]), 0.0)
    ),
    confusable_with=("input_backlash", "coulomb_friction"),
    mujoco="actuators have no dead zone.",
    title="a dead zone of an input",
    what="Commands below a threshold do nothing, as with a valve that opens late.",
    symptom="Small commands move nothing, and each passage through zero brings a pause.",
    remedy="Put a dead zone before that input, or compensate it in the controller.",
)
