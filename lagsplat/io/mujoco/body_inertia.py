"""Inertia of a body in a MuJoCo specification, by the parameters of MuJoCo's identification toolbox.

These are a mass, a mass with its centre, or ten numbers without constraints that make up the pseudo-inertia.
The toolbox's own writer is not used: in MuJoCo 4.0.0 it refuses a mass alone, and models that it changes
cannot be compiled.

Source: Rucker and Wensing, "Smooth parameterization of rigid-body inertia", IEEE Robotics and Automation
Letters 7 (2), 2022, eq. 10: the pseudo-inertia is ``U U'`` of an upper triangular ``U`` whose entries are
``exp(alpha)`` times ``exp(d1..d3)``, 1, the shears ``s12, s23, s13`` and the translation ``t1..t3``.
"""

from typing import Any

import numpy as np

from lagsplat.io.mujoco.package import require_mujoco

SHEARS = ((0, 1), (1, 2), (0, 2))  # places of the shears in the triangle
FULL = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # order of a full inertia in MuJoCo


def set_inertia(spec: Any, name: str, value: np.ndarray) -> None:
    """Set the body's mass (1 number), its mass and centre (4), or all of its inertia (10).

    With a mass alone the inertia about the centre stays.

    Raises:
        ValueError: another number of values, a mass that is not above zero, an inertia that is not the
            body's alone, or the model takes all inertias from geometries.
    """
    if value.size not in (1, 4, 10):
        raise ValueError(f"an inertia has 1, 4 or 10 numbers, not {value.size}")
    if value.size < 10 and value[0] <= 0.0:
        raise ValueError(f"a mass of {value[0]:g}; give one above zero")
    if spec.compiler.inertiafromgeom == int(require_mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE):
        raise ValueError("the model takes every inertia from geometries (inertiafromgeom)")
    mass, center, inertia = read_inertia(spec, name)
    if value.size == 10:
        mass, center, inertia = _unpack_inertia(value)
    else:
        mass = float(value[0])
        center = value[1:4] if value.size == 4 else center
    body = spec.body(name)
    body.explicitinertial, body.mass, body.ipos = True, mass, center
    body.iquat, body.inertia = [1.0, 0.0, 0.0, 0.0], np.zeros(3)  # given as a full inertia instead
    body.fullinertia = [inertia[place] for place in FULL]
    made, *_ = read_inertia(spec, name)
    if not np.isclose(made, mass):  # a URDF's links that are fixed to one another are one body
        raise ValueError(f"MuJoCo adds {made - mass:g} of bodies that are fixed to it; give an MJCF")


def pack_inertia(spec: Any, name: str) -> np.ndarray:
    """The ten numbers of a body's pseudo-inertia (10,).

    Raises:
        ValueError: as `read_inertia`.
    """
    mass, center, inertia = read_inertia(spec, name)
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia + mass * np.outer(center, center)
    pseudo = np.block([[second, mass * center[:, None]], [mass * center[None], np.array([[mass]])]])
    upper = np.linalg.cholesky(pseudo[::-1, ::-1])[::-1, ::-1]
    shape = upper / upper[3, 3]
    shears = [shape[place] for place in SHEARS]
    return np.concatenate([[np.log(upper[3, 3])], np.log(np.diagonal(shape)[:3]), shears, shape[:3, 3]])


def _unpack_inertia(value: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre (3,) and inertia about it (3, 3) of ten numbers."""
    upper = np.eye(4)
    upper[np.diag_indices(3)] = np.exp(value[1:4])
    for place, shear in zip(SHEARS, value[4:7], strict=True):
        upper[place] = shear
    upper[:3, 3] = value[7:10]
    upper *= np.exp(value[0])
    pseudo = upper @ upper.T
    mass = float(pseudo[3, 3])
    center = pseudo[:3, 3] / mass
    second = pseudo[:3, :3] - mass * np.outer(center, center)
    return mass, center, np.trace(second) * np.eye(3) - second


def read_inertia(spec: Any, name: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre (3,) and inertia about it (3, 3) of a body, in its axes.

    Raises:
        ValueError: MuJoCo makes it one with the body that it is fixed to, or refuses the model.
    """
    mujoco, model, turn = require_mujoco(), spec.copy().compile(), np.empty(9)
    if mujoco.mj_name2id(model, int(mujoco.mjtObj.mjOBJ_BODY), name) < 0:
        raise ValueError(f"MuJoCo joins the body {name!r} with the one that it is fixed to")
    body = model.body(name)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3)
    return float(body.mass[0]), np.array(body.ipos), axes @ np.diag(body.inertia) @ axes.T
