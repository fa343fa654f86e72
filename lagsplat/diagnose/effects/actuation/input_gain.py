"""An actuator that is stronger or weaker than the simulation's: ``u_j -> ratio u_j``."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Scale the gain of the actuator."""
    actuator = element.actuator
    actuator.gainprm *= values["ratio"]
    return (f"actuator {actuator.name}: gainprm {element.format_row(actuator.gainprm[:3])}",)


EFFECT = InputEffect(
    name="input_gain",
    group="A",
    number=5,
    equation="u = ratio u_logged",
    parameters=(EffectParameter("ratio", "log_ratio", Normal(0.3), label="ratio (real to simulated)"),),
    needs="the input logged, with free motion beside it",
    acts_everywhere=True,
    change=lambda signal, theta: np.exp(theta[:, :1]) * signal.values,
    confusable_with=("mass_change", "linear_stiffness", "viscous_damping", "input_saturation"),
    mujoco=to_mujoco,
    title="another strength of an input",
    kind="parameter",
    what="The actuator pushes more or less for the same command than in the simulation, or not at all.",
    symptom="Every response to that input is too large or too small by the same factor.",
    remedy="Calibrate the actuator, or set its gain in the simulation anew.",
)
