"""Gains of a position controller that differ: ``kp -> kp_ratio kp``, and damping added by ``kd``."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from lagsplat.diagnose.effects.base import ForceEffect, PlacedEffect, PlaceFinder
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``(kp_ratio - 1) kp (target - q) - kd v``; ``drive`` is ``kp target``."""
    return (math.exp(theta[0]) - 1.0) * (drive - theta[2] * (s + theta[3])) - theta[1] * v


def place(effect: ForceEffect, finder: PlaceFinder) -> list[PlacedEffect]:
    """Along each coordinate whose position target is an input."""
    moving, along = {channel for channel, *_ in finder.inputs}, finder.find_along_controlled(effect)
    return [replace(along[i], channel=channel) for channel, i, _ in finder.targets if channel in moving]


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Scale the gain of the position actuator, and raise its damping."""
    gain, bias = element.actuator.gainprm, element.actuator.biasprm  # views
    gain[0] *= values["kp_ratio"]
    bias[1:3] = values["kp_ratio"] * bias[1], bias[2] - values["kd"] * element.inertia
    return (f"actuator {element.actuator.name}: kp {gain[0]:.6g}, kv {-bias[2]:.6g}",)


EFFECT = ForceEffect(
    name="controller_gain",
    group="A",
    number=9,
    component="actuation",
    level="actuation",
    equation="a = (kp_ratio - 1) kp (u - q) - kd v, u the position target",
    parameters=(
        EffectParameter("kp_ratio", "log_ratio", Normal(0.3), label="kp (real to simulated)"),
        EffectParameter("kd", "rate", Normal(0.2), label="kd (real minus simulated)"),
    ),
    needs="steps of the position target",
    place=place,
    law=force,
    confusable_with=("linear_stiffness", "viscous_damping", "input_gain", "input_lag"),
    mujoco=to_mujoco,
    title="other gains of a position controller",
    kind="parameter",
    what="The controller holds its target more or less stiffly, or damps it differently, than simulated.",
    symptom="Steps of the target are answered with another frequency and another overshoot.",
    remedy="Read kp and kd from the drive, and give them to the simulation.",
)
