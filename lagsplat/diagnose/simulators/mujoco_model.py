"""A simulator that is a MuJoCo model file: mass, bias, passive and actuator forces of chosen joints.

All other joints are fixed where the model's first key frame, or its reference pose, has them. An actuator
with a state counts as one that has settled. Time is continuous: the error of MuJoCo's integrator is not part
of the simulator. Friction loss is dry friction. Contacts, limits and equalities are left out, with a warning.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.simulators.projection import FieldFunctions, ProjectedModel, project_fields


@dataclass(frozen=True)
class MujocoSelection:
    """A compiled model with its data, and the joints and actuators that serve as coordinates and inputs."""

    model: Any
    data: Any
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    at_q: np.ndarray  # positions of the coordinates in `qpos`
    at_v: np.ndarray  # positions of the coordinates in `qvel`
    at_u: np.ndarray  # positions of the inputs in `ctrl`


def require_mujoco() -> Any:
    """The module ``mujoco``, which is an optional dependency.

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


def load_mujoco(
    path: Path, *, joints: Sequence[str] | None = None, actuators: Sequence[str] | None = None
) -> MujocoSelection:
    """Load a model file with its joints and actuators, by default all hinges, slides and actuators in order.

    Raises:
        FileNotFoundError: no such file.
        ValueError: MuJoCo cannot read it or is not installed, a name is not in it, a joint is free or a ball,
        or no joint is left.
    """
    mujoco = require_mujoco()
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ValueError(f"{path}: MuJoCo cannot read it ({error})") from error
    straight = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    joint_names = [model.joint(i).name for i in range(model.njnt)]
    actuator_names = [model.actuator(i).name for i in range(model.nu)]
    index = _find_indices(path, "joint", joints, joint_names)
    if joints is None:
        index = [i for i in index if model.jnt_type[i] in straight]
    for i in index:
        if model.jnt_type[i] not in straight:
            raise ValueError(
                f"{path}: joint {joint_names[i]!r} is a ball or free; only hinges and slides serve"
            )
    if not index:
        raise ValueError(f"{path}: has no hinge and no slide; nothing to diagnose")
    driven = _find_indices(path, "actuator", actuators, actuator_names)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    return MujocoSelection(
        model,
        data,
        tuple(joint_names[i] or f"joint {i}" for i in index),
        tuple(actuator_names[i] or f"actuator {i}" for i in driven),
        model.jnt_qposadr[index],
        model.jnt_dofadr[index],
        np.array(driven, dtype=np.int64),
    )


def project_mujoco(
    path: Path,
    region: OperatingRegion,
    *,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
) -> ProjectedModel:
    """The model of a MuJoCo file over a region, with a warning of what it leaves out.

    ``joints`` are the coordinates (default: all hinges and slides), ``actuators`` the inputs (default: all).

    Raises:
        FileNotFoundError: no such file.
        ValueError: as `load_mujoco`, or another number of joints or actuators than the recording has columns.
    """
    chosen = load_mujoco(path, joints=joints, actuators=actuators)
    counted = (("joints", chosen.joints, region.d, "q"), ("actuators", chosen.actuators, region.n_u, "u"))
    for what, names, n, letter in counted:
        if len(names) != n:
            raise ValueError(
                f"{path}: {len(names)} {what} {list(names)}, but the recording has {n} column(s) {letter}; "
                f"name those that belong to them with diagnose.{what}=[...]"
            )
    warn_of_omissions(path, chosen, region)
    return project_fields(make_mujoco_fields(chosen), region, what=path.name)


def make_mujoco_fields(chosen: MujocoSelection) -> FieldFunctions:
    """Mass, forces and input map of the chosen joints as functions of many points."""
    mujoco = require_mujoco()
    model, data, at_v = chosen.model, chosen.data, chosen.at_v
    d, n_u = len(at_v), len(chosen.at_u)
    dry = model.dof_frictionloss[at_v].copy()
    filters = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
    no_speed, no_input = np.zeros(d), np.zeros(n_u)

    def set_state(q: np.ndarray, v: np.ndarray = no_speed, u: np.ndarray = no_input) -> None:
        data.qvel[:] = 0.0
        data.ctrl[:] = 0.0
        data.qpos[chosen.at_q], data.qvel[at_v], data.ctrl[chosen.at_u] = q, v, u
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)

    def actuation() -> np.ndarray:
        """Force of actuators that have settled at their command."""
        for i in range(model.nu):
            if model.actuator_actadr[i] >= 0 and model.actuator_dyntype[i] in filters:
                data.act[model.actuator_actadr[i]] = data.ctrl[i]
        mujoco.mj_fwdActuation(model, data)
        return data.qfrc_actuator[at_v].copy()

    def mass(q: np.ndarray) -> np.ndarray:
        masses, full = np.empty((len(q), d, d)), np.zeros((model.nv, model.nv))
        for n, point in enumerate(q):
            set_state(point)
            mujoco.mj_fullM(model, data, full)
            masses[n] = full[np.ix_(at_v, at_v)]
        return masses

    def potential_gradient(q: np.ndarray) -> np.ndarray:
        gradients = np.empty_like(q)
        for n, point in enumerate(q):
            set_state(point)
            gradients[n] = data.qfrc_bias[at_v] - data.qfrc_passive[at_v] - actuation()
        return gradients

    def dissipation(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        forces = np.empty_like(q)
        for n, (point, velocity) in enumerate(zip(q, v, strict=True)):
            set_state(point)
            still = data.qfrc_passive[at_v] + actuation()
            set_state(point, velocity)
            forces[n] = still - data.qfrc_passive[at_v] - actuation() + dry * np.sign(velocity)
        return forces

    def input_map(q: np.ndarray) -> np.ndarray:
        forces = np.empty((len(q), n_u, d))
        for n, point in enumerate(q):
            set_state(point)
            unloaded = actuation()
            for c, size in enumerate(_list_test_commands(model, chosen.at_u)):
                set_state(point, u=size * np.eye(n_u)[c])
                forces[n, c] = (actuation() - unloaded) / size
        return forces

    return FieldFunctions(mass, potential_gradient, input_map, dissipation)


def find_position_targets(chosen: MujocoSelection) -> list[tuple[int, int]]:
    """Numbers of the inputs that are position targets of a chosen joint, each with the joint's number.

    Such an actuator pulls its joint with ``kp (target - position)``; one with a gear is none.
    """
    model, kinds, found = chosen.model, require_mujoco(), []
    for channel, i in enumerate(chosen.at_u):
        at_joint = (
            model.actuator_trntype[i] == int(kinds.mjtTrn.mjTRN_JOINT) and model.actuator_gear[i, 0] == 1.0
        )
        affine = model.actuator_biastype[i] == int(kinds.mjtBias.mjBIAS_AFFINE)
        gain = model.actuator_gainprm[i, 0]
        if not (at_joint and affine and gain > 0.0 and model.actuator_biasprm[i, 1] == -gain):
            continue
        at = np.flatnonzero(chosen.at_v == model.jnt_dofadr[model.actuator_trnid[i, 0]])
        found += [(channel, int(coordinate)) for coordinate in at]
    return found


def _list_test_commands(model: Any, index: np.ndarray) -> list[float]:
    """A command within each actuator's range, at most 1, by which its gain is measured."""
    commands = []
    for i in index:
        low, high = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-1.0, 1.0)
        commands.append(float(min(1.0, high) if high > 0.0 else max(-1.0, low)))
    return commands


def _find_indices(path: Path, what: str, wanted: Sequence[str] | None, names: list[str]) -> list[int]:
    """The places of the ``wanted`` names, by default of all."""
    if wanted is None:
        return list(range(len(names)))
    for name in wanted:
        if name not in names:
            raise ValueError(f"{path}: no {what} {name!r}, only {names}")
    if len(set(wanted)) != len(wanted):
        raise ValueError(f"{path}: {what}s {list(wanted)} name one twice")
    return [names.index(name) for name in wanted]


def warn_of_omissions(path: Path, chosen: MujocoSelection, region: OperatingRegion) -> None:
    """Warn of what the model has beyond mass, forces and inputs."""
    model, mujoco, omitted = chosen.model, require_mujoco(), []
    for n, name in enumerate(chosen.joints):
        joint = int(np.flatnonzero(model.jnt_dofadr == chosen.at_v[n])[0])
        low, high = model.jnt_range[joint]
        if model.jnt_limited[joint] and not _is_within(region.q[:, n], low, high):
            omitted.append(
                f"the range {low:g} to {high:g} of joint {name!r}, beyond which the recording goes"
            )
    for n, (i, name) in enumerate(zip(chosen.at_u, chosen.actuators, strict=True)):
        low, high = model.actuator_ctrlrange[i]
        if model.actuator_ctrllimited[i] and not _is_within(region.u[:, n], low, high):
            omitted.append(f"the range {low:g} to {high:g} of actuator {name!r}")
        if model.actuator_dyntype[i] != int(mujoco.mjtDyn.mjDYN_NONE):
            omitted.append(f"the state of actuator {name!r}, which counts as settled")
        if model.actuator_delay[i] > 0.0:
            omitted.append(f"the delay of actuator {name!r}")
    if model.neq:
        omitted.append(f"{model.neq} equality constraint(s)")
    data = chosen.data
    for point in region.q[:: max(1, len(region.q) // 50)]:  # 50 points, because contacts are slow to find
        data.qpos[chosen.at_q] = point
        mujoco.mj_fwdPosition(model, data)
        if data.ncon:
            omitted.append("contacts between bodies")
            break
    if omitted:
        warnings.warn(f"{path.name}: not in the sim as it is diagnosed: {'; '.join(omitted)}", stacklevel=3)


def _is_within(values: np.ndarray, low: float, high: float) -> bool:
    return bool(low <= values.min() and values.max() <= high)
