"""Clocks of motion and inputs that disagree: ``u(t) = u_logged(t + offset)`` for every input at once.

Motion that is stamped late, a negative offset, looks the same as a delay of every input.
"""

from lagsplat.diagnose.effects.actuation.input_delay import delay_input
from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal

EFFECT = InputEffect(
    name="time_offset",
    group="G",
    number=1,
    component=None,
    level="perception",
    equation="y(t) = q(t + offset)",
    parameters=(
        EffectParameter("offset", "time", Normal(0.5), (-1.2, -0.6, -0.2, -0.05, 0.05, 0.2, 0.6, 1.2)),
    ),
    needs="an input with steps, and an event that starts without it",
    along="whole",
    change=lambda signal, theta: delay_input(signal, -theta),
    time_shift="offset",
    confusable_with=("input_delay", "input_lag"),
    mujoco="it concerns the clocks of the recording, not the mechanism.",
    title="clocks of motion and inputs that disagree",
    kind="observation",
    what="The log of the inputs is shifted in time against the motion.",
    symptom="All responses start too early or too late by the same time; the physics is right.",
    remedy="Shift one clock by the offset; leave the simulation alone.",
)
