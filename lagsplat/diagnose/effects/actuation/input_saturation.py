"""An actuator at its limit: ``u = u / (1 + |u / limit|^sharpness)^(1 / sharpness)``.

A large sharpness cuts the input at the limit; flux, valves and amplifiers give way before it. The least
sharpness, one, leaves no straight part.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, LogNormal, log_normal


def change(signal: Any, theta: Float64[np.ndarray, "P 2"]) -> Float64[np.ndarray, "P M"]:
    """Return the input, which comes ever closer to the limit on both sides."""
    limit, sharpness = theta[:, :1], theta[:, 1:2]
    size = np.abs(signal.values) / limit
    # the larger of input and limit is divided out, so that no power overflows
    small = np.minimum(size, 1.0 / np.maximum(size, 1e-300))
    given = np.minimum(size, 1.0) / (1.0 + small**sharpness) ** (1.0 / sharpness)
    return np.sign(signal.values) * limit * given


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Narrow the control range of the actuator, which cuts sharply."""
    actuator, selection = element.actuator, element.selection
    limit = float(values["limit"])
    i = selection.at_u[selection.actuators.index(actuator.name)]
    low, high = -np.inf, np.inf
    if selection.model.actuator_ctrllimited[i]:
        low, high = selection.model.actuator_ctrlrange[i]
    actuator.ctrllimited = int(element.mujoco.mjtLimited.mjLIMITED_TRUE)
    actuator.ctrlrange = np.array([max(low, -limit), min(high, limit)])
    return (f"actuator {actuator.name}: ctrlrange {element.format_row(actuator.ctrlrange)}",)


EFFECT = InputEffect(
    name="input_saturation",
    group="C",
    number=4,
    equation="u = u_logged / (1 + |u_logged / limit|^sharpness)^(1 / sharpness)",
    parameters=(
        EffectParameter("limit", "input", log_normal(1.0, 0.5), (0.4, 0.7, 1.0, 1.4, 2.0)),
        EffectParameter("sharpness", "ratio", LogNormal(1.0, math.log(10.0), lowest=0.0), (4.0, 20.0)),
    ),
    needs="inputs on both sides of the limit",
    acts_everywhere=True,
    change=change,
    confusable_with=("input_gain",),
    mujoco=to_mujoco,
    title="an actuator at its limit",
    what="Above some command the actuator gives no more.",
    symptom="Weak commands are answered as predicted, strong ones too weakly.",
    remedy="Limit that input of the simulation, or command less.",
)
