"""A valve or gear that ignores small inputs: ``u = sign(u) max(|u| - half_width, 0)``."""

import numpy as np

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.excitation import make_grade
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal

EFFECT = InputEffect(
    name="input_dead_zone",
    group="C",
    number=3,
    equation="u = sign(u_logged) max(|u_logged| - half_width, 0)",
    parameters=(EffectParameter("half_width", "input", log_normal(0.3, 1.0), (0.05, 0.2, 0.5, 1.0)),),
    needs="slow, small inputs through zero",
    excitation=lambda channel, m: make_grade(
        channel.crosses_zero and channel.small_share > 0.1,
        channel.small_share > 0.03,
        f"{channel.name} {'crosses zero' if channel.crosses_zero else 'stays on one side of zero'}, "
        f"{100 * channel.small_share:.2g} % of it small",
        f"let it pass slowly through zero for {10 * m.period_s:.3g} s",
    ),
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
