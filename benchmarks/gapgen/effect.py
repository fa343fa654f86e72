"""Names of the effects, what is known of a recording when one is sized, and one effect at one magnitude."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Row = tuple[int, int, int, list[float]]  # law, coordinate, input, numbers

IN_CLASS = (
    "viscous_damping",
    "linear_stiffness",
    "mass_change",
    "constant_force",
    "input_gain",
    "cubic_stiffness",
)
DISSIPATION = ("coulomb_friction", "stribeck_friction", "load_dependent_friction", "quadratic_drag")
ACTUATION = ("input_lag", "input_delay", "input_dead_zone", "input_saturation", "input_backlash")
MEMORY = ("hysteresis", "creep", "joint_backlash")
CONTACT = ("end_stop", "external_periodic_force", "parameter_drift", "hidden_mode")
FAMILIES = IN_CLASS + DISSIPATION + ACTUATION + MEMORY + CONTACT
EXTRA = ("external_push",)
CAMERA = ("time_offset", "time_jitter", "frame_drops", "camera_change", "camera_drift", "exposure_blur")
OUTSIDE = (
    "cogging",
    "parametric_excitation",
    "local_damping",
    "potential_bump",
    "one_way_damping",
    "sudden_change",
    "random_force",
    "self_excitation",
    "input_stiffness",
    "input_rectification",
    "resonant_actuator",
)
MACHINE = (
    "payload",
    "armature",
    "controller_gain",
    "torque_speed_limit",
    "encoder_scale",
    "cogging",
    "position_dependent_damping",
    "asymmetric_friction",
    "parametric_stiffness",
    "circulatory_force",
    "base_motion",
)
"""Effects of the wide groups alone; four of them are outside the catalogue, by other names, in the others."""
NOW_INSIDE = ("cogging", "parametric_excitation", "local_damping", "one_way_damping")
"""Effects outside the catalogue in the older groups that an entry covers by now."""
OUTSIDE_WIDE = (
    *(name for name in OUTSIDE if name not in NOW_INSIDE),
    "fractional_memory",
    "belt_friction",
    "speed_softening",
)
OUTSIDE_FORCED = ("input_stiffness", "input_rectification", "resonant_actuator")
DISCREPANCIES = tuple(name for name in OUTSIDE_WIDE if name not in OUTSIDE_FORCED)
"""Laws by which nature differs from nominal equations and catalogue, beside what is to be found."""
NEEDS_INPUT = (
    *ACTUATION,
    "input_gain",
    "time_offset",
    "torque_speed_limit",
    "controller_gain",
    *OUTSIDE_FORCED,
)


@dataclass(frozen=True)
class Setting:
    """What the nominal motion is like: the scales by which magnitudes are chosen.

    ``f1_hz`` (d,) the frequency of each coordinate, ``x`` and ``v`` (d,) rms of coordinate and speed,
    ``top`` (d,) and ``v_top`` (d,) their peaks, ``u`` (n_u,) rms and ``u_top`` peaks of the inputs,
    ``span_s`` and ``dt_s`` the recording, ``zeta`` (d,) damping ratio, ``film`` whether cameras
    matter as such. For effects of the wide groups, ``wide``, there are the inertia at rest (d,), what a unit
    of each input gives over it, ``gain`` (d, n_u), and the mass [kg] that doubles the inertia of each
    coordinate (d,), zero where none can, and the acceleration of the base that accelerates the first
    coordinate by one.
    """

    f1_hz: Array
    x: Array
    v: Array
    top: Array
    v_top: Array
    u: Array
    u_top: Array
    zeta: Array
    span_s: float
    dt_s: float
    forced: bool
    system: str
    film: bool = False
    wide: bool = False
    inertia: Array = field(default_factory=lambda: np.zeros(0))
    gain: Array = field(default_factory=lambda: np.zeros((0, 0)))
    payload_kg: Array = field(default_factory=lambda: np.zeros(0))
    base_reach: float = 1.0


@dataclass
class Effect:
    """One effect at one magnitude.

    ``rows`` enter the equations of motion, ``operators`` (input, name, numbers) the inputs, ``camera`` (name,
    numbers) the observation; ``parameters`` is the truth in the units of the report.
    """

    name: str
    rows: list[Row] = field(default_factory=list)
    operators: list[tuple[int, str, dict[str, float]]] = field(default_factory=list)
    camera: tuple[str, dict[str, Any]] | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    coordinate: int | None = None
    input: int | None = None
    time_s: list[list[float]] = field(default_factory=list)
    frequency_hz: list[float] = field(default_factory=list)


Maker = Callable[[float], Effect]
