"""A MuJoCo chain as one model of one coordinate for each joint, the motion of the others taken as measured.

Along the measured motion ``(q, v, a)`` the inverse dynamics give the force ``tau`` on joint j that the file
needs, without the spring, the damper and the friction of the joint itself. Its model is

    m q_j'' = gear u_j + b_j(t) + spring + damper + friction,   b_j = m a_j - tau_j,

where ``m`` is the median of ``M_jj`` along the motion. Gravity, Coriolis forces and the inertia of the others
are in ``b_j``, an input that is computed and not logged. Where the model moves as measured the equation is
exact; what ``M_jj`` deviates from ``m`` acts on the difference of both alone.

Source: recursive Newton-Euler inverse dynamics, Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 5,
as MuJoCo computes them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import JOINTS
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation.dataset import OperatingRegion, prepare_dataset, sample_operating_region
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.latent_force import SmoothedMotion, smooth_motions
from lagsplat.diagnose.simulators.mujoco_model import (
    MujocoSelection,
    load_mujoco,
    make_mujoco_fields,
    require_mujoco,
)
from lagsplat.diagnose.simulators.projection import FieldFunctions, project_fields
from lagsplat.io.trajectory.trajectory import Trajectory

COUPLING = "coupling of {}"
"""Name of the computed input of a joint."""


@dataclass(frozen=True)
class JointModel:
    """One joint of a MuJoCo chain as a simulator of its own, with its recordings."""

    joint: str
    actuator: str
    model: MechanicalModel  # of one coordinate; its inputs are the actuator and the coupling
    motions: tuple[Trajectory, ...]  # this coordinate, the torque and the coupling
    inertia: float  # reference inertia `m`, in the units of the file


def match_motors(path: Path, chosen: MujocoSelection, region: OperatingRegion) -> dict[int, int]:
    """The input that drives each joint alone, by the number of the joint; none for joints without one.

    Such an input acts on one joint, with the same gain wherever it is and no force of its own.
    """
    model, mujoco = chosen.model, require_mujoco()
    fields = make_mujoco_fields(chosen)
    gains = fields.input_map(region.q[:: max(1, len(region.q) // JOINTS.gain_points)])  # (N, n_u, d)
    size = np.abs(gains).max(axis=0)
    found = {}
    for channel, i in enumerate(chosen.at_u):
        driven = np.flatnonzero(size[channel] > JOINTS.gain_tolerance * size[channel].max())
        of_state = model.actuator_biastype[i] != int(mujoco.mjtBias.mjBIAS_NONE)
        with_state = model.actuator_dyntype[i] != int(mujoco.mjtDyn.mjDYN_NONE)
        if len(driven) != 1 or of_state or with_state:
            continue
        joint = int(driven[0])
        others = np.delete(size[:, joint], channel)
        if np.ptp(gains[:, channel, joint]) > JOINTS.gain_tolerance * size[channel, joint] or others.any():
            continue
        found[joint] = channel
    return found


def build_joint_models(
    path: Path,
    motions: Sequence[Trajectory],
    *,
    hold: str,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
) -> tuple[JointModel, ...]:
    """A model for every joint that is a coordinate of the motions.

    Args:
        path: the MuJoCo file.
        motions: recordings of all coordinates with the torque of each.
        hold: "zoh" where inputs are held between samples, else "linear"; see `average_held`.
        joints, actuators: as of `load_mujoco`.

    Raises:
        FileNotFoundError, ValueError: as `load_mujoco`; another number of joints or actuators than columns; a
            joint without a motor of its own; a coordinate that never moves.
    """
    chosen = load_mujoco(path, joints=joints, actuators=actuators)
    ready = prepare_dataset(motions, period_s=estimate_spectral_period_s(motions))
    motors = match_motors(path, chosen, sample_operating_region(ready.dataset))
    lacking = [name for i, name in enumerate(chosen.joints) if i not in motors]
    if lacking:
        raise ValueError(
            f"{path}: no logged torque acts on {', '.join(lacking)} alone; give each joint a motor and log it"
        )
    periods_s = [
        estimate_spectral_period_s([_pick_coordinate(motion, i) for motion in motions])
        for i in range(len(chosen.joints))
    ]
    smoothed = smooth_motions(motions, periods_s=periods_s)
    forces = [compute_chain_forces(chosen, each) for each in smoothed]
    return tuple(
        _build_joint_model(path, chosen, motions, smoothed, forces, joint, motors[joint], hold)
        for joint in range(len(chosen.joints))
    )


@dataclass(frozen=True)
class ChainForces:
    """Forces on the chosen joints along a motion, in the units of the file."""

    required: Float64[np.ndarray, "T d"]  # what actuators and friction have to give, damping being the file's
    own: Float64[np.ndarray, "T d"]  # spring and damper of each joint itself
    inertia: Float64[np.ndarray, "T d"]  # diagonal of the mass matrix


def compute_chain_forces(chosen: MujocoSelection, motion: SmoothedMotion) -> ChainForces:
    """The inverse dynamics of a motion. Contacts, limits and equalities are left out, and so is friction loss.

    Joints that are not chosen rest where the data of ``chosen`` have them.
    """
    mujoco, at_v = require_mujoco(), chosen.at_v
    model, data = chosen.model, chosen.data
    n, d = motion.q.shape
    required, inertia = np.empty((n, d)), np.empty((n, d))
    full, product, a = np.zeros((model.nv, model.nv)), np.zeros(model.nv), np.zeros(model.nv)
    data.ctrl[:] = 0.0
    for k in range(n):
        data.qvel[:] = 0.0
        data.qpos[chosen.at_q], data.qvel[at_v], a[at_v] = motion.q[k], motion.v[k], motion.a[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_mulM(model, data, product, a)
        mujoco.mj_fullM(model, data, full)
        required[k] = (product + data.qfrc_bias - data.qfrc_passive)[at_v]
        inertia[k] = np.diagonal(full)[at_v]
    own = np.stack(
        [compute_own_force(chosen, i, motion.q[:, i], motion.v[:, i]) for i in range(d)], axis=1
    )
    return ChainForces(required, own, inertia)


def compute_own_force(
    chosen: MujocoSelection, joint: int, q: Float64[np.ndarray, " N"], v: Float64[np.ndarray, " N"]
) -> Float64[np.ndarray, " N"]:
    """Spring and damper of one joint, while all others rest in the reference pose of the file."""
    mujoco, model, data = require_mujoco(), chosen.model, chosen.data
    at_q, at_v = chosen.at_q[joint], chosen.at_v[joint]
    data.qpos[:], data.qvel[:] = model.qpos0, 0.0
    force = np.empty(len(q))
    for k, (position, rate) in enumerate(zip(q, v, strict=True)):
        data.qpos[at_q], data.qvel[at_v] = position, rate
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        force[k] = data.qfrc_spring[at_v] + data.qfrc_damper[at_v]
    return force


def average_held(values: Float64[np.ndarray, " T"], motion: Trajectory) -> Float64[np.ndarray, " T"]:
    """The mean of a smooth signal from each sample to the next of its clip, as an input that is held."""
    ahead = np.arange(motion.n) + np.append(motion.joined, False)
    return 0.5 * (values + values[ahead])


def _build_joint_model(
    path: Path,
    chosen: MujocoSelection,
    motions: Sequence[Trajectory],
    smoothed: Sequence[SmoothedMotion],
    forces: Sequence[ChainForces],
    joint: int,
    channel: int,
    hold: str,
) -> JointModel:
    name, actuator = chosen.joints[joint], chosen.actuators[channel]
    unit = float(np.median(np.concatenate([each.inertia[:, joint] for each in forces])))
    pieces = []
    for motion, smooth, force in zip(motions, smoothed, forces, strict=True):
        coupling = unit * smooth.a[:, joint] - force.required[:, joint] - force.own[:, joint]
        if hold == "zoh":
            coupling = average_held(coupling, motion)
        alone = _pick_coordinate(motion, joint)
        names = (actuator, COUPLING.format(name))
        u = np.stack([motion.u[:, channel], coupling], axis=1)
        pieces.append(replace(alone, u=u, q_names=(name,), u_names=names, computed=names[1:]))
    ready = prepare_dataset(pieces, period_s=estimate_spectral_period_s(pieces))
    region = sample_operating_region(ready.dataset)
    gain = float(make_mujoco_fields(chosen).input_map(np.median(smoothed[0].q, axis=0)[None])[0, channel, joint])
    fields = _make_joint_fields(chosen, joint, unit, gain)
    model = project_fields(fields, region, what=f"{path.name}, joint {name}").model
    return JointModel(name, actuator, model, tuple(pieces), unit)


def _make_joint_fields(chosen: MujocoSelection, joint: int, inertia: float, gain: float) -> FieldFunctions:
    dry = float(chosen.model.dof_frictionloss[chosen.at_v[joint]])

    def own(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return compute_own_force(chosen, joint, q[:, 0], v[:, 0])[:, None]

    return FieldFunctions(
        mass=lambda q: np.full((len(q), 1, 1), inertia),
        potential_gradient=lambda q: -own(q, np.zeros_like(q)),
        input_map=lambda q: np.tile([[[gain], [1.0]]], (len(q), 1, 1)),
        dissipation=lambda q, v: own(q, np.zeros_like(q)) - own(q, v) + dry * np.sign(v),
    )


def _pick_coordinate(motion: Trajectory, i: int) -> Trajectory:
    """The motion of one coordinate without inputs."""
    return replace(
        motion,
        q=motion.q[:, i : i + 1],
        v=None if motion.v is None else motion.v[:, i : i + 1],
        u=np.zeros((motion.n, 0)),
        q_names=motion.q_names[i : i + 1],
        u_names=(),
        resolution=motion.resolution[i : i + 1],
    )
