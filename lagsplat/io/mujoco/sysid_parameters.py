"""Parameters that MuJoCo's identification toolbox fitted, put into a model file and read off two of them.

`mujoco.sysid` keeps the meaning of a parameter in the user's program; a file has its name alone, which so
has to say it: ``ELEMENT_ATTRIBUTE``, an attribute of a joint, an actuator or a body, as ``elbow_damping``.
The name ``BODY_inertia`` is the toolbox's own, for a mass, a mass with its centre, or the ten numbers of a
pseudo-inertia.
"""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.io.files.sysid_yaml import SysidParameter, read_sysid_parameters
from lagsplat.io.mujoco.body_inertia import pack_inertia, read_inertia, set_inertia
from lagsplat.io.mujoco.package import get_angle_unit

SPRING_REFERENCE = "springref"  # a position of the joint, in degrees where the file is
OF_JOINT = ("damping", "frictionloss", "armature", "stiffness", SPRING_REFERENCE)
OF_ACTUATOR = ("gear", "gain", "pgain", "dgain", "pdgain")
OF_BODY = ("mass", "inertia")
SIGNED = (SPRING_REFERENCE, "gear", "gain")  # attributes that may be negative
WORLD = "world"
ROUNDING = 1e-5  # relative: MuJoCo writes six digits
BOUND = 10.0  # bounds over the larger of two values, as the toolbox has them for masses


def apply_sysid_parameters(path: Path, spec: Any, file: Path) -> None:
    """Put the values in ``file`` into the specification of the model at ``path``; frozen ones stay out.

    Raises:
        FileNotFoundError: there is no ``file``.
        ValueError: it holds no parameters, or a name does not say what of this model it is.
    """
    for parameter in read_sysid_parameters(file):
        if parameter.frozen:
            continue
        places = list(_find_places(spec, parameter.name))
        if len(places) != 1:
            found = f"{len(places)} elements" if places else "no element"
            of_each = f"{', '.join(OF_JOINT)} of a joint, {', '.join(OF_ACTUATOR)} of an actuator"
            raise ValueError(
                f"{file}: parameter {parameter.name!r} names {found} of {path.name}. Names are "
                f"ELEMENT_ATTRIBUTE, with {of_each} and {', '.join(OF_BODY)} of a body; or give the "
                "identified model, which save_results of the toolbox writes, as sim="
            )
        try:
            _set(spec, *places[0], parameter.value.reshape(-1))
        except (ValueError, TypeError) as error:
            value = parameter.value.tolist()
            raise ValueError(
                f"{file}: parameter {parameter.name!r} of {value} does not fit ({error})"
            ) from error


def _find_places(spec: Any, name: str) -> Iterator[tuple[Any, str]]:
    """The elements, with their attributes, that the name of a parameter stands for."""
    groups = ((spec.joints, OF_JOINT), (spec.actuators, OF_ACTUATOR), (spec.bodies, OF_BODY))
    for elements, attributes in groups:
        for element, attribute in product(elements, attributes):
            if element.name and name == f"{element.name}_{attribute}":
                yield element, attribute


def _get(element: Any, attribute: str) -> np.ndarray:
    value = element.gainprm[0] if attribute == "gain" else getattr(element, attribute)
    return np.array(value, dtype=np.float64)


def _set(spec: Any, element: Any, attribute: str, value: np.ndarray) -> None:
    if attribute in OF_BODY:
        set_inertia(spec, element.name, value if attribute == "inertia" else value[:1])
    elif attribute in ("pgain", "dgain", "pdgain"):
        _set_servo_gains(element, attribute, value)
    elif attribute == "gain":
        element.gainprm[0] = value[0]
    else:
        present = _get(element, attribute)
        if value.size > present.size:
            raise ValueError(f"{attribute} has {present.size} number(s), not {value.size}")
        if present.ndim:
            present[: value.size] = value
        setattr(element, attribute, present if present.ndim else float(value[0]))


def _set_servo_gains(actuator: Any, attribute: str, value: np.ndarray) -> None:
    """Set gains of a position actuator, whose bias holds them with the sign reversed."""
    if actuator.gainprm[0] != -actuator.biasprm[1]:
        raise ValueError(f"{actuator.name} is no position actuator")
    if attribute != "dgain":
        actuator.gainprm[0], actuator.biasprm[1] = value[0], -value[0]
    if attribute != "pgain":
        actuator.biasprm[2] = -value[-1]


def list_sysid_parameters(before: Any, after: Any) -> tuple[tuple[SysidParameter, ...], tuple[str, ...]]:
    """The parameters in which two specifications of one model differ, and what else differs, for people.

    The first is the nominal value, the second the value. Bounds reach ten times as far as the larger.
    """
    found: list[SysidParameter] = []
    for elements, others, attributes in (
        (before.joints, after.joints, OF_JOINT),
        (before.actuators, after.actuators, ("gear", "gain")),
    ):
        named = {element.name: element for element in others}
        for element, attribute in product(elements, attributes):
            if element.name not in named:
                continue
            nominal, value = (np.atleast_1d(_get(x, attribute)) for x in (element, named[element.name]))
            if attribute == SPRING_REFERENCE:
                value = value * get_angle_unit(after, element) / get_angle_unit(before, element)
            found += _difference(f"{element.name}_{attribute}", attribute, nominal, value)
    found += _inertias(before, after)
    trial, kept, others = before.copy(), [], []
    for parameter in found:
        (place,) = _find_places(trial, parameter.name)
        try:
            _set(trial, *place, parameter.value)
        except ValueError as error:
            others.append(f"{parameter.name} ({error})")
        else:
            kept.append(parameter)
    return tuple(kept), (*others, *_left_over(trial, after))


def _difference(name: str, attribute: str, nominal: np.ndarray, value: np.ndarray) -> list[SysidParameter]:
    """The parameter if its values differ, up to the last number that is not zero."""
    if np.allclose(nominal, value, rtol=ROUNDING, atol=0.0):
        return []
    used = max(int(np.flatnonzero(each).max(initial=0)) for each in (nominal, value)) + 1
    nominal, value = nominal[:used], value[:used]
    reach = BOUND * np.maximum(np.maximum(np.abs(nominal), np.abs(value)), np.finfo(float).tiny)
    low = -reach if attribute in SIGNED else np.zeros(used)
    return [SysidParameter(name, nominal, value, low, reach)]


def _inertias(before: Any, after: Any) -> list[SysidParameter]:
    """Pseudo-inertias of the bodies whose mass, centre or inertia differ."""
    parameters = []
    for name in (body.name for body in before.bodies if body.name and body.name != WORLD):
        try:
            one, other = read_inertia(before, name), read_inertia(after, name)
        except ValueError:  # MuJoCo joined it with another
            continue
        sizes = [float(np.max(np.abs(part))) for part in one]
        if all(np.allclose(one[i], other[i], rtol=ROUNDING, atol=ROUNDING * sizes[i]) for i in range(3)):
            continue
        start, fitted = pack_inertia(before, name), pack_inertia(after, name)
        # logarithms of mass and stretch, shears, and the centre [m], each as far as the toolbox has them
        reach = np.r_[0.5 * np.log(BOUND), np.full(3, 0.5 * np.log(2.0)), np.full(6, 0.5)]
        low, high = np.minimum(start - reach, fitted), np.maximum(start + reach, fitted)
        parameters.append(SysidParameter(f"{name}_inertia", start, fitted, low, high))
    return parameters


def _left_over(trial: Any, after: Any) -> tuple[str, ...]:
    """Elements of the second specification that the first one does not have with these parameters."""
    texts = [spec.copy() for spec in (trial, after)]
    for spec in texts:
        spec.compile()
    ours, theirs = (set(spec.to_xml().splitlines()) for spec in texts)
    kinds = ("<joint", "<motor", "<general", "<position", "<velocity", "<damper", "<fixed", "<plugin")
    return tuple(line.strip() for line in sorted(theirs - ours) if line.strip().startswith(kinds))
