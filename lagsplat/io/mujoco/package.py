"""The package ``mujoco``, which is an optional dependency, and units in its specifications."""

from typing import Any

import numpy as np

from lagsplat.io.files.optional_package import require_package


def require_mujoco() -> Any:
    """The module ``mujoco``.

    Raises:
        ValueError: it is not installed.
    """
    return require_package("mujoco", what="a MuJoCo model", extra="mujoco")


def get_angle_unit(spec: Any, joint: Any) -> float:
    """Unit of a joint's positions in a specification: a degree for hinges of files in degrees, else 1."""
    hinge = joint.type == require_mujoco().mjtJoint.mjJNT_HINGE
    return np.pi / 180.0 if hinge and spec.compiler.degree else 1.0
