"""Read a MuJoCo model file or a URDF: its joints as coordinates and its actuators as inputs.

Joints that a linear equality ties to the chosen ones follow them. All others are fixed where the model's
first key frame, or its reference pose, has them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.io.mujoco.package import require_mujoco
from lagsplat.io.mujoco.sysid_parameters import apply_sysid_parameters
from lagsplat.io.mujoco.urdf_spec import load_urdf

URDF = ".urdf"


@dataclass(frozen=True)
class Follower:
    """A joint that equalities tie to the coordinates ``q``: its position is ``offset + ratios @ q``."""

    at_q: int  # its position in `qpos`
    at_v: int  # its position in `qvel`
    offset: float
    ratios: np.ndarray  # (d,)


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
    followers: tuple[Follower, ...] = ()

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Rates of all of the model's degrees of freedom over those of the coordinates, (nv, d)."""
        rates = np.zeros((self.model.nv, len(self.at_v)))
        rates[self.at_v, np.arange(len(self.at_v))] = 1.0
        for follower in self.followers:
            rates[follower.at_v] = follower.ratios
        return rates

    def set_positions(self, q: np.ndarray) -> None:
        """Put the coordinates ``q`` (d,), and what follows them, into the data, and place the bodies."""
        self.data.qpos[self.at_q] = q
        for follower in self.followers:
            self.data.qpos[follower.at_q] = follower.offset + follower.ratios @ q
        require_mujoco().mj_fwdPosition(self.model, self.data)

    def set_state(self, q: np.ndarray, v: np.ndarray | None = None, u: np.ndarray | None = None) -> None:
        """Put coordinates, their rates (d,) and the inputs (n_u,), by default zero, into the data."""
        self.data.qvel[:], self.data.ctrl[:] = 0.0 if v is None else self.jacobian @ v, 0.0
        self.data.ctrl[self.at_u] = 0.0 if u is None else u
        self.set_positions(q)
        require_mujoco().mj_fwdVelocity(self.model, self.data)

    def measure_mass(self) -> np.ndarray:
        """The mass matrix (nv, nv) of all degrees of freedom where the data are."""
        full = np.zeros((self.model.nv, self.model.nv))
        require_mujoco().mj_fullM(self.model, self.data, full)
        return full


def load_spec(path: Path, parameters: str | None = None) -> Any:
    """The MuJoCo specification of a model file or a URDF, not compiled.

    ``parameters`` is a file of `mujoco.sysid` whose values replace the model's own.

    Raises:
        FileNotFoundError: no such file.
        ValueError: MuJoCo cannot read it or is not installed, or a parameter is none of the model.
    """
    mujoco = require_mujoco()
    if path.suffix.lower() == URDF:
        spec, _ = load_urdf(path)
    elif not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    else:
        try:
            spec = mujoco.MjSpec.from_file(str(path))
        except ValueError as error:
            raise ValueError(f"{path}: MuJoCo cannot read it ({error})") from error
    if parameters is not None:
        apply_sysid_parameters(path, spec, Path(parameters).expanduser())
    return spec


def load_mujoco(
    path: Path,
    *,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
    parameters: str | None = None,
) -> MujocoSelection:
    """Load a model file with its joints and actuators, by default all hinges, slides and actuators in order.

    Joints that follow others by a linear equality are coordinates only where they are named. ``parameters``
    is as of `load_spec`.

    Raises:
        FileNotFoundError: no such file.
        ValueError: MuJoCo cannot read it or is not installed, a name is not in it, a joint is free or a ball,
        or no joint is left.
    """
    mujoco = require_mujoco()
    spec = load_spec(path, parameters)
    try:
        model = spec.compile()
    except ValueError as error:
        raise ValueError(f"{path}: MuJoCo cannot read it ({error})") from error
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    tied = _find_ties(model)
    straight = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    joint_names = [model.joint(i).name for i in range(model.njnt)]
    actuator_names = [model.actuator(i).name for i in range(model.nu)]
    index = _find_indices(path, "joint", joints, joint_names)
    if joints is None:
        index = [i for i in index if model.jnt_type[i] in straight and i not in tied]
    for i in index:
        if model.jnt_type[i] not in straight:
            raise ValueError(
                f"{path}: joint {joint_names[i]!r} is a ball or free; only hinges and slides serve"
            )
    if not index:
        raise ValueError(f"{path}: has no hinge and no slide; nothing to diagnose")
    driven = _find_indices(path, "actuator", actuators, actuator_names)
    return MujocoSelection(
        model,
        data,
        tuple(joint_names[i] or f"joint {i}" for i in index),
        tuple(actuator_names[i] or f"actuator {i}" for i in driven),
        model.jnt_qposadr[index],
        model.jnt_dofadr[index],
        np.array(driven, dtype=np.int64),
        _find_followers(model, data, index, tied),
    )


def _find_ties(model: Any) -> dict[int, tuple[int, float, float]]:
    """Joints that an active linear equality ties: the other joint or -1, the offset, and the ratio."""
    kinds, ties = require_mujoco(), {}
    for i in range(model.neq):
        is_joint = model.eq_type[i] == int(kinds.mjtEq.mjEQ_JOINT)
        constant, slope, *bends = model.eq_data[i][:5]
        if not is_joint or not model.eq_active0[i] or np.any(bends):
            continue
        first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        offset = model.qpos0[model.jnt_qposadr[first]] + constant
        if second >= 0:
            offset -= slope * model.qpos0[model.jnt_qposadr[second]]
        ties[first] = (second, float(offset), float(slope))
    return ties


def _find_followers(
    model: Any, data: Any, index: Sequence[int], ties: Mapping[int, tuple[int, float, float]]
) -> tuple[Follower, ...]:
    """The joints that are tied to the chosen ones, directly or through other tied joints."""
    one = np.eye(len(index))
    known = {joint: (0.0, one[n]) for n, joint in enumerate(index)}
    left = {joint: tie for joint, tie in ties.items() if joint not in known}
    while ready := [joint for joint, tie in left.items() if tie[0] not in left]:
        for joint in ready:
            leader, offset, ratio = left.pop(joint)
            at_rest = (float(data.qpos[model.jnt_qposadr[leader]]) if leader >= 0 else 0.0, 0.0 * one[0])
            base, ratios = known.get(leader, at_rest)
            known[joint] = (offset + ratio * base, ratio * ratios)
    tied = [joint for joint in known if joint not in index]
    at_q, at_v = model.jnt_qposadr, model.jnt_dofadr
    return tuple(Follower(int(at_q[each]), int(at_v[each]), *known[each]) for each in tied)


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
