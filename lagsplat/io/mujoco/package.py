"""The package ``mujoco``, which is an optional dependency, and units in its specifications."""

from typing import Any

import numpy as np


def require_mujoco() -> Any:
    """The module ``mujoco``.

    Raises:
        ValueError: it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ValueError(
            "a MuJoCo model needs the package mujoco; install it with: pip install 'lagsplat[mujoco]'"
        ) from error
    return mujoco


def get_angle_unit(spec: Any, joint: Any) -> float:
    """Unit of a joint's positions in a specification: a degree for hinges of files in degrees, else 1."""
    hinge = joint.type == require_mujoco().mjtJoint.mjJNT_HINGE
    return np.pi / 180.0 if hinge and spec.compiler.degree else 1.0
