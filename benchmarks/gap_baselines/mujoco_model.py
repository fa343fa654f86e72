"""Mechanisms as a user of MuJoCo would write them down, from the number of coordinates and inputs alone.

A mass on every link; every input may drive every joint by a motor of its own. Lengths and springs to
begin from follow from the rms period of the motion.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
from mujoco import sysid

GRAVITY = 9.81
STEP_S = 1e-3
LEAST_INERTIA = 1e-9
"""Moment of inertia of a link, in the unit of mass times metres squared."""
KINDS = {1: ("chain", "cart"), 2: ("chain", "bag", "cart_pole"), 4: ("chain",)}
"""Candidate mechanisms by number of coordinates."""


@dataclass(frozen=True)
class Drawn:
    """A mechanism and its parameters to be identified; ``kind`` says which one."""

    kind: str
    spec: mujoco.MjSpec
    parameters: sysid.ParameterDict = field(repr=False)


def draw(kind: str, d: int, n_u: int, *, guess_s: float, dt_s: float, size: float) -> Drawn:
    """The mechanism ``kind`` with ``d`` joints ``q0 ...`` and ``n_u`` inputs, motors ``m<i>_<j>``.

    ``guess_s`` is the rms period of the motion, ``dt_s`` the time between its samples, ``size`` the reach of
    its coordinates, by which bounds are set.
    """
    stiffness = (2.0 * np.pi / guess_s) ** 2
    length = GRAVITY / stiffness
    maker = {"chain": _chain, "cart": _cart, "bag": _bag, "cart_pole": _cart_pole}[kind]
    bodies = maker(d, length)
    step_s = dt_s / np.ceil(dt_s / STEP_S)
    motors = "".join(
        f'<motor name="m{i}_{j}" joint="q{i}" gear="{1.0 if i == j % d else 0.0}"/>'
        for i in range(d)
        for j in range(n_u)
    )
    sensors = "".join(f'<jointpos name="q{i}" joint="q{i}"/>' for i in range(d))
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option gravity="0 0 -{GRAVITY}" timestep="{step_s}" integrator="implicitfast">'
        f'<flag contact="disable" autoreset="disable"/></option><worldbody>{bodies}</worldbody>'
        f"<actuator>{motors}</actuator><sensor>{sensors}</sensor></mujoco>"
    )
    return Drawn(kind, spec, _own(kind, d, n_u, length=length, stiffness=stiffness, size=size))


def _chain(d: int, length: float) -> str:
    text = ""
    for i in reversed(range(d)):
        place = f' pos="0 0 -{length / d}"' if i else ""
        text = (
            f'<body name="b{i}"{place}><joint name="q{i}" type="hinge" axis="0 -1 0"/>'
            f'<inertial pos="0 0 -{length / d}" mass="1" diaginertia="1e-6 1e-6 1e-6"/>{text}</body>'
        )
    return text


def _cart(d: int, length: float) -> str:
    return (
        '<body name="b0"><joint name="q0" type="slide" axis="1 0 0"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/></body>'
    )


def _bag(d: int, length: float) -> str:
    return (
        '<body name="b0"><joint name="q0" type="hinge" axis="0 -1 0"/>'
        '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-8 1e-8 1e-8"/>'
        f'<body name="b1" pos="0 0 -{length}"><joint name="q1" type="slide" axis="0 0 -1"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1e-6 1e-6 1e-6"/></body></body>'
    )


def _cart_pole(d: int, length: float) -> str:
    return (
        '<body name="b0"><joint name="q0" type="slide" axis="1 0 0"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>'
        '<body name="b1"><joint name="q1" type="hinge" axis="0 -1 0"/>'
        f'<inertial pos="0 0 -{length}" mass="0.3" diaginertia="1e-6 1e-6 1e-6"/></body></body>'
    )


def _own(kind: str, d: int, n_u: int, *, length: float, stiffness: float, size: float) -> sysid.ParameterDict:
    """What is identified on the nominal motions; the first mass is the unit of mass."""
    out = sysid.ParameterDict()

    def add(name: str, value: float, low: float, high: float, write: Callable) -> None:
        out.add(sysid.Parameter(name, value, low, high, modifier=write))

    slides = [kind == "cart" or (kind == "cart_pole" and i == 0) for i in range(d)]
    inertias = [1.0 if slide else length**2 for slide in slides]
    for i, inertia in enumerate(inertias):
        loss = 0.04 * inertia * np.sqrt(stiffness)
        add(f"damping{i}", loss, 0.0, 30.0 * loss, joint_field(f"q{i}", "damping"))
        if kind == "chain":
            add(f"length{i}", length / d, 0.2 * length / d, 3.0 * length / d, _length(i, d))
        if (kind in ("chain", "cart_pole")) and i > 0:
            add(f"mass{i}", 0.3 if kind == "cart_pole" else 0.7, 0.1, 5.0, _mass(i))
        if kind == "chain" and d > 1:
            add(f"inertia{i}", 0.01 * inertia, 1e-3 * inertia, inertia, _inertia(i))
        if slides[i] or (kind == "bag" and i == 1) or (kind == "chain" and d > 1):
            spring = stiffness * (inertia if kind == "chain" else 1.0)
            begin = (0.1 if kind == "chain" else 4.0 if kind == "bag" else 1.0) * spring
            add(f"stiffness{i}", begin, 0.0, 30.0 * spring, joint_field(f"q{i}", "stiffness"))
        if slides[i]:
            high = 3.0 * stiffness / size**2
            add("cubic0", 0.01 * high, 0.0, high, joint_field("q0", "stiffness", 2))
    if kind in ("bag", "cart_pole"):
        add("length0", length, 0.2 * length, 4.0 * length, _length(1, d))
    for i, inertia in enumerate(inertias):
        for j in range(n_u):
            gear = inertia * (1.0 if i == j % d else 0.0)
            add(f"gear{i}_{j}", gear, -30.0 * inertia, 30.0 * inertia, gear_field(f"m{i}_{j}"))
    return out


def joint_field(name: str, key: str, order: int | None = 0) -> Callable:
    """A modifier that writes a joint's field, or one coefficient of a polynomial in it."""

    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        joint = spec.joint(name)
        if order is None:
            setattr(joint, key, float(parameter.value[0]))
        else:
            values = np.array(getattr(joint, key), dtype=float)
            values[order] = parameter.value[0]
            setattr(joint, key, values)

    return write


def gear_field(name: str) -> Callable:
    """A modifier that writes a motor's gain."""

    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        spec.actuator(name).gear[0] = parameter.value[0]

    return write


def _length(i: int, d: int) -> Callable:
    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        end = [0.0, 0.0, -float(parameter.value[0])]
        if spec.body("b1") is not None and spec.joint("q1").type == mujoco.mjtJoint.mjJNT_SLIDE:
            spec.body("b1").pos = end
            return
        spec.body(f"b{i}").ipos = end
        if i + 1 < d:
            spec.body(f"b{i + 1}").pos = end

    return write


def _inertia(i: int) -> Callable:
    """A modifier that writes the moment of inertia of a link about its own centre."""

    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        moment = max(float(parameter.value[0]), LEAST_INERTIA)  # a finite difference may step below its bound
        spec.body(f"b{i}").inertia = [moment, moment, moment]

    return write


def _mass(i: int) -> Callable:
    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        spec.body(f"b{i}").mass = parameter.value[0]

    return write
