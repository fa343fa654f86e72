"""Gains of a position controller that differ: ``kp -> kp_ratio kp``, and damping added by ``kd``."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from lagsplat.diagnose.data_quality.excitation_measures import ExcitationMeasures
from lagsplat.diagnose.effects.base import ForceEffect, Grade, PlacedEffect, PlaceFinder
from lagsplat.diagnose.effects.excitation import ask_for_steps, make_grade
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``(kp_ratio - 1) kp (target - q) - kd v``; ``drive`` is ``kp target``."""
    return (math.exp(theta[0]) - 1.0) * (drive - theta[2] * (s + theta[3])) - theta[1] * v


def grade_excitation(measures: ExcitationMeasures) -> Grade:
    """It shows where the target steps, and where a load holds the joint off it."""
    steps = max((channel.steps for channel in measures.inputs if channel.moves), default=0)
    reason = f"{steps} step(s) of an input" if measures.inputs else "no target is recorded"
    yes, weak = steps >= 3 and measures.periods > 3, measures.driven and measures.periods > 3
    return make_grade(yes, weak, reason, ask_for_steps(measures))


def place(effect: ForceEffect, finder: PlaceFinder) -> list[PlacedEffect]:
    """Along each coordinate whose position target is an input."""
    moving, along, places = (
        {channel for channel, *_ in finder.inputs},
        finder.find_along_coordinates(effect),
        [],
    )
    for channel, coordinate, gain in finder.targets:
        placed = along[coordinate]
        assert placed.direction is not None
        if channel in moving:
            places.append(replace(placed, channel=channel, constants=(gain, placed.direction.rest)))
    return places


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Scale the gain of the position actuator, and raise its damping."""
    actuator = element.actuator
    gain, bias = (np.asarray(row, dtype=np.float64).copy() for row in (actuator.gainprm, actuator.biasprm))
    gain[0], bias[1] = values["kp_ratio"] * gain[0], values["kp_ratio"] * bias[1]
    bias[2] -= values["kd"] * element.inertia
    actuator.gainprm, actuator.biasprm = gain, bias
    return (f"actuator {actuator.name}: kp {gain[0]:.6g}, kv {-bias[2]:.6g}",)


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
    energy_bounded=lambda p, placed: p["kd"] >= 0.0,
    excitation=grade_excitation,
    confusable_with=("linear_stiffness", "viscous_damping", "input_gain", "input_lag"),
    mujoco=to_mujoco,
    title="other gains of a position controller",
    kind="parameter",
    what="The controller holds its target more or less stiffly, or damps it differently, than simulated.",
    symptom="Steps of the target are answered with another frequency and another overshoot.",
    remedy="Read kp and kd from the drive, and give them to the simulation.",
)
