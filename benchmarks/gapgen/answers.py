"""The truth about a recording in the words and units of the diagnosis."""

from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.gapgen.drawing import Recording, Stratum
from benchmarks.gapgen.effect import ACTUATION, CAMERA, NEEDS_INPUT, OUTSIDE, OUTSIDE_WIDE, Effect
from benchmarks.gapgen.sources import source_of

COMPONENTS = {
    "viscous_damping": "dissipative",
    "linear_stiffness": "conservative",
    "mass_change": "inertial",
    "constant_force": "conservative",
    "input_gain": "actuation",
    "cubic_stiffness": "conservative",
    "coulomb_friction": "dissipative",
    "stribeck_friction": "dissipative",
    "load_dependent_friction": "dissipative",
    "quadratic_drag": "dissipative",
    **dict.fromkeys(ACTUATION, "actuation"),
    "hysteresis": "memory",
    "creep": "memory",
    "joint_backlash": "conservative",
    "end_stop": "conservative",
    "external_periodic_force": "exogenous",
    "external_push": "exogenous",
    "parameter_drift": "exogenous",
    "hidden_mode": "memory",
    "payload": "inertial",
    "armature": "inertial",
    "controller_gain": "actuation",
    "torque_speed_limit": "actuation",
    "cogging": "conservative",
    "position_dependent_damping": "dissipative",
    "asymmetric_friction": "dissipative",
    "parametric_stiffness": "conservative",
    "circulatory_force": "conservative",
    "base_motion": "exogenous",
}

HOLDING = {
    # creep that yields at once is damping, and one that hardly yields is stiffness; a mass scales both
    "viscous_damping": ("creep", "mass_change", "position_dependent_damping", "asymmetric_friction"),
    "linear_stiffness": ("creep", "mass_change"),
    # a mass within, held so stiffly that it moves along; a load without weight
    "mass_change": ("hidden_mode", "payload", "armature"),
    "armature": ("hidden_mode", "payload"),
    "payload": ("hidden_mode",),
    # a zoom, in small motions, and beside a gain what bends in large ones
    "input_gain": ("camera_change", "encoder_scale"),
    "camera_change": ("input_gain", "encoder_scale"),
    "encoder_scale": ("input_gain",),
    "cubic_stiffness": ("camera_change", "encoder_scale"),
    # friction without excess, without load, without give, the same in both directions
    "coulomb_friction": (
        "stribeck_friction",
        "load_dependent_friction",
        "hysteresis",
        "asymmetric_friction",
    ),
    # a light oscillator within that was swinging already; a base that moves one coordinate alone
    "external_periodic_force": ("hidden_mode", "base_motion"),
    # a limit that is reached at speed alone
    "input_saturation": ("torque_speed_limit",),
}
"""Families that hold an effect as a limit: with them in the catalogue it is not left out."""

SMALLEST_GAP = 1.4  # gap, over its floor, from which an effect can be seen [1]

LINEAR = ("linear_cart", "mujoco_cart")
"""Systems whose nominal equations are linear."""


def reported(name: str, s: Stratum) -> str:
    """The name a diagnosis can give: ``unknown`` for what is outside the catalogue of the stratum's group."""
    return "unknown" if name in (OUTSIDE if s.conditions is None else OUTSIDE_WIDE) else name


def equivalent(effect: Effect, s: Stratum, truth: dict[str, Any]) -> list[str]:
    """Names that this recording cannot tell from the effect, itself included, by the structural classes."""
    name, p = effect.name, effect.parameters
    same = {reported(name, s)}
    i = effect.coordinate or 0
    w = 2.0 * np.pi * truth["natural_hz"][0]
    linear = s.system in LINEAR
    if name in ("coulomb_friction", "stribeck_friction"):
        same |= {"coulomb_friction", "stribeck_friction"}
    if name in ("input_delay", "time_offset"):
        sign = p.get("delay", -p.get("offset", 0.0))
        same |= {"input_delay", "time_offset"} if sign > 0 else {"time_offset"}
        if 0 < sign * w < 0.35:
            same |= {"input_lag"}
    if name == "input_lag" and p["time_constant"] * w < 0.35:
        same |= {"input_delay", "time_offset"}
    if name in ("mass_change", "input_gain"):
        same |= {"mass_change", "input_gain"} if s.forced else set()
    if name in ("mass_change", "linear_stiffness") and not s.forced:
        same |= {"mass_change", "linear_stiffness"}
    if name == "hysteresis" and p["displacement"] < 0.06 * truth["rms"][i]:
        same |= {"coulomb_friction", "stribeck_friction"}
    if name == "creep":
        if p["time_constant"] * w < 0.5 or (not s.forced and len(truth["rms"]) == 1):
            same |= {"viscous_damping"}
        if p["time_constant"] * w > 15.0:
            same |= {"linear_stiffness"}
        if truth["span_s"] < 2.0 * p["time_constant"]:
            same |= {"parameter_drift"}
    near = name in ("external_periodic_force", "hidden_mode") and min(
        abs(p["frequency_hz"] / f - 1.0) for f in truth["natural_hz"]
    )
    if name in ("external_periodic_force", "hidden_mode") and near < 0.15:
        same |= {"external_periodic_force", "hidden_mode"}
    if name == "hidden_mode" and p["frequency_hz"] > 2.5 * truth["natural_hz"][-1]:
        same |= {"mass_change"} | ({"linear_stiffness"} if not s.forced else set())
    if name == "constant_force" or (name == "camera_change" and abs(p["zoom"] - 1.0) < 0.1):
        same |= {"constant_force", "camera_change"}
    if name == "input_gain" and linear and s.forced:
        same |= {"camera_change"}
    if name == "camera_change" and linear and s.forced and abs(p["zoom"] - 1.0) >= 0.1:
        same |= {"input_gain", "mass_change"}
    slow = name == "camera_drift" or (name == "parameter_drift" and p["of"] == "force")
    if slow and linear:
        same |= {"camera_drift", "parameter_drift"}
    if name == "cubic_stiffness" and s.system == "duffing_cart" and not s.forced:
        # zoom changes what a cube weighs beside the coordinate; of a driven one the input's gain, too
        same |= {"camera_change"}
    if name in ("viscous_damping", "quadratic_drag") and not s.forced and s.duration_s < 6.0:
        same |= {"viscous_damping", "quadratic_drag"}
    if s.conditions is not None:
        same |= _equivalent_in_logs(effect, s, same, single=len(truth["rms"]) == 1)
    return sorted(same)


def _equivalent_in_logs(effect: Effect, s: Stratum, same: set[str], *, single: bool) -> set[str]:
    """Further names of the wide groups: a log has encoders, and one coordinate one inertia."""
    name, p, more = effect.name, effect.parameters, set()
    linear = s.system in LINEAR
    if name in ("armature", "payload") and single:
        # with its weight it leaves frequencies alone, and damping counts for less
        hangs = name == "payload" and "pendulum" in s.system
        more |= {
            "mass_change",
            "input_gain" if s.forced else "viscous_damping" if hangs else "linear_stiffness",
        }
    if name == "mass_change" and single:
        more |= {"payload"} if p["ratio"] > 1.0 else set()
        more |= {"viscous_damping"} if "pendulum" in s.system and not s.forced else set()
    if name == "payload" and s.system in ("cart_pole", "mujoco_cart_pole", "furuta", "rotational_actuator"):
        # it moves on the level, with a constant inertia
        more |= {"armature"}
    if name == "encoder_scale" and abs(p["scale"] - 1.0) < 0.1:
        more |= {"constant_force"}
    if name == "encoder_scale" and linear and s.forced and abs(p["scale"] - 1.0) >= 0.1:
        more |= {"input_gain", "mass_change"}
    if "camera_change" in same:
        more |= {"encoder_scale"}
    return more


def left_out(same: list[str]) -> list[str]:
    """What must go for an effect of the class ``same`` to be none of the catalogue's."""
    return sorted({*same, *(name for one in same for name in HOLDING.get(one, ()))})


def identifiable(effect: Effect, s: Stratum, truth: dict[str, Any], ratio: float) -> tuple[bool, str]:
    """Whether physics lets this recording name the effect's class, and the reason if not."""
    if not ratio >= SMALLEST_GAP:
        return False, "the effect is below the noise at one period"
    if effect.name == "exposure_blur":
        return False, "a moving mean of coordinates is a change of amplitude and a shift in time"
    if effect.name in NEEDS_INPUT and not s.forced:
        return False, "no input"
    if s.duration_s < 6.0 and effect.name in ("creep", "parameter_drift", "camera_drift"):
        return False, "too short for a slow effect"
    if s.duration_s < 6.0 and ratio < 3.0:
        return False, "too short for so small a gap"
    if effect.name in ("camera_change", "encoder_scale") and not s.forced and s.system in LINEAR:
        return False, "the scale of a linear free motion is arbitrary"
    return True, ""


def answer(identity: str, s: Stratum, recording: Recording, split: str) -> dict[str, Any]:
    """One line of the answers."""
    truth = dict(recording.truth)
    effects: list[Effect] = truth.pop("found")
    ratios = truth.pop("targets")
    items = []
    for effect, ratio in zip(effects, ratios, strict=True):
        possible, reason = identifiable(effect, s, truth, ratio)
        items.append(
            {
                "name": reported(effect.name, s),
                "kind": effect.name,
                "parameters": effect.parameters,
                "coordinate": None if effect.coordinate is None else f"q{effect.coordinate}",
                "input": None if effect.input is None else f"u{effect.input}",
                "class": equivalent(effect, s, truth),
                "component": COMPONENTS.get(reported(effect.name, s)),
                "level": _level(effect.name),
                "time_s": effect.time_s,
                "frequency_hz": effect.frequency_hz,
                "ratio": ratio,
                "identifiable": possible,
                "why_not": reason,
            }
        )
    gaps = truth["gap"]
    return {
        "id": identity,
        "split": split,
        "effects": [item["name"] for item in items] or ["none"],
        "truth": items,
        "system": s.system,
        "source": source_of(s.system),
        "conditions": None if s.conditions is None else asdict(s.conditions),
        "d": len(truth["rms"]),
        "forced": s.forced,
        "noise": s.noise,
        "duration_s": s.duration_s,
        "bin_drawn": s.bin,
        "bin": _bin(gaps["before"] / gaps["floor"]),
        "gap_ratio": gaps["before"] / gaps["floor"],
        "identifiable": all(item["identifiable"] for item in items),
        **truth,
    }


def _bin(ratio: float) -> str:
    return "none" if ratio < 1.5 else "low" if ratio < 3.0 else "middle" if ratio < 10.0 else "high"


def _level(name: str) -> str:
    if name == "encoder_scale":
        return "perception"
    if name in CAMERA:
        return "chart" if name in ("camera_change", "camera_drift", "exposure_blur") else "perception"
    return "actuation" if COMPONENTS.get(name) == "actuation" else "dynamics"
