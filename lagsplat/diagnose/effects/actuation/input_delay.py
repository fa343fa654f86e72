"""An input that arrives late as a whole: ``u(t) = u_logged(t - delay)``."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal


def delay_input(signal: Any, theta: Float64[np.ndarray, "P 1"]) -> Float64[np.ndarray, "P M"]:
    """Return the input as it was ``delay`` ago; before the first sample of a clip, that sample."""
    return np.stack([signal.at(signal.time - delay) for delay in theta[:, 0]])


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Lengthen the delay of the actuator."""
    actuator = element.actuator
    delay = float(actuator.delay) + values["delay"]
    actuator.delay = delay
    actuator.nsample = int(np.ceil(delay / float(element.spec.option.timestep))) + 2
    actuator.interp = 1
    return (f"actuator {actuator.name}: delay {delay:.6g}",)


EFFECT = InputEffect(
    name="input_delay",
    group="C",
    number=2,
    equation="u(t) = u_logged(t - delay)",
    parameters=(EffectParameter("delay", "time", log_normal(0.3, 1.0), (0.05, 0.2, 0.6, 1.2)),),
    needs="an input with steps, and an event that starts without it",
    acts_everywhere=True,
    change=delay_input,
    time_shift="delay",
    confusable_with=("time_offset", "input_lag"),
    mujoco=to_mujoco,
    title="a delay of an input",
    what="The actuator follows its command, a fixed time later.",
    symptom="Nothing happens for a moment after each step, then everything as predicted.",
    remedy="Delay that input in the simulation, or find the wait in the communication.",
)
