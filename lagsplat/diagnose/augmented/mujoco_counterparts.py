"""Which element of a MuJoCo model says what an effect of the catalogue says, and how it is changed.

A generalised force of a diagnosis is an acceleration times the reference inertia of its joint, the diagonal
of the mass matrix at rest; here it becomes a force again. Each function changes a specification, and tells
what it changed; it returns nothing, and has changed nothing that is written, where there is no counterpart.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from lagsplat.diagnose.effects.dynamics.linear_stiffness import SPRING
from lagsplat.diagnose.simulators.mujoco_model import MujocoSelection, require_mujoco

FAINT = 1e-6
"""Stiffness, relative to the force, of the spring that stands for a constant force."""
SOFT = 0.005
"""Impedance of a limit that adds its force to the others instead of taking their place."""


@dataclass(frozen=True)
class Place:
    """Where an effect acts: elements of the model's specification, and the reference inertia there."""

    spec: Any
    chosen: MujocoSelection
    joint: Any
    """None where the effect acts on the whole of several joints."""
    actuator: Any
    inertia: float
    compliance: float
    """Diagonal of the inverse mass at rest."""
    rest: float
    variant: str
    stiffness: float
    """Angular frequency squared that stiffness ratios of the effect count in [1/s^2]."""

    @property
    def unit(self) -> float:
        """Unit of the joint's positions in the specification: a degree for hinges of files in degrees."""
        hinge = self.joint.type == require_mujoco().mjtJoint.mjJNT_HINGE
        return np.pi / 180.0 if hinge and self.spec.compiler.degree else 1.0


def _spring(place: Place) -> Polynomial:
    """Force of the joint's spring with the sign reversed, over its coordinate."""
    joint = place.joint
    shifted = Polynomial([-float(joint.springref) * place.unit, 1.0])
    k = np.asarray(joint.stiffness, dtype=np.float64)
    return Polynomial([0.0, *k])(shifted)


def _add_spring(place: Place, added: Polynomial) -> tuple[str, ...]:
    """Add to the joint's spring; MuJoCo counts powers from where the spring is slack, a root."""
    joint, total = place.joint, (_spring(place) + added).trim()
    size = float(np.abs(total.coef).max())
    if total.degree() < 1:
        total = total + Polynomial([0.0, FAINT * size])
    roots = total.roots()
    real = roots.real[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots))]
    if not len(real):
        return ()
    slack = float(real[np.argmin(np.abs(real - float(joint.springref) * place.unit))])
    about = total(Polynomial([slack, 1.0]))
    k = np.zeros(3)
    k[: about.degree()] = about.coef[1:]
    joint.stiffness, joint.springref = k, slack / place.unit
    return (f"joint {joint.name}: stiffness {_row(k)} about springref {slack:.6g}",)


def _damping(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    return _raise_damping(place, 0, values["rate"])


def _drag(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    return _raise_damping(place, 1, values["coefficient"])


def _raise_damping(place: Place, power: int, value: float) -> tuple[str, ...]:
    if place.joint is None:
        return ()
    row = np.asarray(place.joint.damping, dtype=np.float64).copy()
    row[power] += value * place.inertia
    if row[power] < 0.0:
        return ()
    place.joint.damping = row
    return (f"joint {place.joint.name}: damping {_row(row)}",)


def _friction(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    if place.joint is None:
        return ()
    place.joint.frictionloss = float(place.joint.frictionloss) + values["acceleration"] * place.inertia
    return (f"joint {place.joint.name}: frictionloss {place.joint.frictionloss:.6g}",)


def _constant(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    return _add_spring(place, Polynomial([-values["acceleration"] * place.inertia])) if place.joint else ()


def _cubic(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    if place.joint is None:
        return ()
    return _add_spring(place, values["coefficient"] * place.inertia * Polynomial([-place.rest, 1.0]) ** 3)


def _stiffness(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    """The whole potential: gravity, springs and what servos hold with; or a spring beside these."""
    if place.variant == SPRING:
        added = (values["ratio"] - 1.0) * place.stiffness * place.inertia
        return _add_spring(place, added * Polynomial([-place.rest, 1.0]))
    ratio, gravity = values["ratio"], np.asarray(place.spec.option.gravity, dtype=np.float64)
    alone = len(place.chosen.joints) == 1
    if place.joint is not None and not alone:
        return () if gravity.any() else _scale_springs([place.joint], ratio)
    place.spec.option.gravity = ratio * gravity
    told = _scale_springs([j for j in place.spec.joints if j.name in place.chosen.joints], ratio)
    for actuator in place.spec.actuators:
        bias = np.asarray(actuator.biasprm, dtype=np.float64).copy()
        bias[:2] *= ratio
        actuator.biasprm = bias
    return (*told, f"gravity {_row(place.spec.option.gravity)}")


def _scale_springs(joints: Sequence[Any], ratio: float) -> tuple[str, ...]:
    told = []
    for joint in joints:
        joint.stiffness = ratio * np.asarray(joint.stiffness, dtype=np.float64)
        if np.any(joint.stiffness):
            told.append(f"joint {joint.name}: stiffness {_row(joint.stiffness)}")
    return tuple(told)


def _mass(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    ratio = values["ratio"]
    alone = len(place.chosen.joints) == 1
    if place.joint is not None and not (alone and place.variant == "weight"):
        armature = float(place.joint.armature) + (ratio - 1.0) * place.inertia
        if armature < 0.0:
            return ()
        place.joint.armature = armature
        return (f"joint {place.joint.name}: armature {armature:.6g}",)
    _scale_masses(place.spec, ratio)
    for joint in place.spec.joints:
        joint.armature = ratio * float(joint.armature)
    told = [f"all masses times {ratio:.6g}"]
    if place.variant == "weight":
        told += _scale_springs(place.spec.joints, ratio)
    else:
        place.spec.option.gravity = np.asarray(place.spec.option.gravity, dtype=np.float64) / ratio
        told.append(f"gravity {_row(place.spec.option.gravity)}, so that the weight stays")
    return tuple(told)


def _scale_masses(spec: Any, ratio: float) -> None:
    for body in spec.bodies:
        if body.explicitinertial:
            body.mass = ratio * body.mass
            body.inertia = ratio * np.asarray(body.inertia, dtype=np.float64)
            body.fullinertia = ratio * np.asarray(body.fullinertia, dtype=np.float64)
    for geom in spec.geoms:
        if np.isnan(geom.mass):
            geom.density = ratio * geom.density
        else:
            geom.mass = ratio * geom.mass


def _gain(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    if place.actuator is None:
        return ()
    place.actuator.gainprm = values["ratio"] * np.asarray(place.actuator.gainprm, dtype=np.float64)
    return (f"actuator {place.actuator.name}: gainprm {_row(place.actuator.gainprm[:3])}",)


def _lag(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    mujoco = require_mujoco()
    if place.actuator is None or place.actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE:
        return ()
    place.actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
    row = np.asarray(place.actuator.dynprm, dtype=np.float64).copy()
    row[0] = values["time_constant"]
    place.actuator.dynprm = row
    return (f"actuator {place.actuator.name}: dyntype filterexact, dynprm {row[0]:.6g}",)


def _delay(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    if place.actuator is None:
        return ()
    delay = float(place.actuator.delay) + values["delay"]
    place.actuator.delay = delay
    place.actuator.nsample = int(np.ceil(delay / float(place.spec.option.timestep))) + 2
    place.actuator.interp = 1
    return (f"actuator {place.actuator.name}: delay {delay:.6g}",)


def _saturation(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    mujoco = require_mujoco()
    if place.actuator is None:
        return ()
    limit = float(values["limit"])
    i = place.chosen.at_u[place.chosen.actuators.index(place.actuator.name)]
    low, high = -np.inf, np.inf
    if place.chosen.model.actuator_ctrllimited[i]:
        low, high = place.chosen.model.actuator_ctrlrange[i]
    place.actuator.ctrllimited = int(mujoco.mjtLimited.mjLIMITED_TRUE)
    place.actuator.ctrlrange = np.array([max(low, -limit), min(high, limit)])
    return (f"actuator {place.actuator.name}: ctrlrange {_row(place.actuator.ctrlrange)}",)


def _stop(place: Place, values: Mapping[str, Any]) -> tuple[str, ...]:
    mujoco = require_mujoco()
    joint, push = place.joint, float(values["stiffness_ratio"]) * place.stiffness
    if joint is None or place.variant not in ("upper", "lower") or push <= 0.0:
        return ()
    if place.chosen.model.joint(joint.name).limited[0]:
        return ()
    far = 1e3 * (1.0 + abs(values["position"]))
    side = 1.0 if place.variant == "upper" else -1.0
    edge = place.rest + side * float(values["position"])
    joint.limited = int(mujoco.mjtLimited.mjLIMITED_TRUE)
    between = np.array([edge - far, edge] if side > 0.0 else [edge, edge + far])
    joint.range = between / place.unit
    # of direct stiffness; so faint an impedance leaves the other forces as they are
    joint.solref_limit = np.array([-push * place.inertia * place.compliance, -1e-9])
    joint.solimp_limit = np.array([SOFT, SOFT, 0.001, 0.5, 2.0])
    return (f"joint {joint.name}: range {_row(between)}, solreflimit {_row(joint.solref_limit)}",)


def _row(values: Any) -> str:
    return " ".join(f"{value:.6g}" for value in np.asarray(values, dtype=np.float64))


COUNTERPARTS: Mapping[str, Callable[[Place, Mapping[str, Any]], tuple[str, ...]]] = {
    "viscous_damping": _damping,
    "quadratic_drag": _drag,
    "coulomb_friction": _friction,
    "constant_force": _constant,
    "cubic_stiffness": _cubic,
    "linear_stiffness": _stiffness,
    "mass_change": _mass,
    "input_gain": _gain,
    "input_lag": _lag,
    "input_delay": _delay,
    "input_saturation": _saturation,
    "end_stop": _stop,
}
