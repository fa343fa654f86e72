"""The package ``mujoco``, which is an optional dependency, and units in its specifications."""

import logging
from typing import Any

import numpy as np

from lagsplat.io.files.optional_package import require_package

log = logging.getLogger(__name__)


def require_mujoco() -> Any:
    """The module ``mujoco``, whose warnings are logged; by itself it writes them to a file where it runs.

    Raises:
        ValueError: it is not installed.
    """
    mujoco = require_package("mujoco", what="a MuJoCo model", extra="mujoco")
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_log_warning)
    return mujoco


def _log_warning(text: str) -> None:
    log.warning("MuJoCo: %s", text)


def get_angle_unit(spec: Any, joint: Any) -> float:
    """Unit of a joint's positions in a specification: a degree for hinges of files in degrees, else 1."""
    hinge = joint.type == require_mujoco().mjtJoint.mjJNT_HINGE
    return np.pi / 180.0 if hinge and spec.compiler.degree else 1.0
