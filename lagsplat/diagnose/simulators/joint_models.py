"""A MuJoCo chain as one model of one coordinate for each joint, the motion of the others taken as measured.

Along the measured motion ``(q, v, a)`` inverse dynamics give the force ``tau`` that joint j needs, beside its
own spring, damper and friction loss. Its model is

    m q_j'' = gain u_j + b_j(t) + spring + damper + friction,   b_j = m a_j - tau_j,

where ``m`` is the median of ``M_jj`` along the motion. Gravity, Coriolis forces and the inertia of the others
are in ``b_j``, an input that is computed and not logged. Where the model moves as measured, the equation is
exact; what ``M_jj`` deviates from ``m`` acts on the difference of both alone.

Torques may act some time before or after their stamp: MuJoCo's integrator lets them act half a time step
early. The rate of the torque is a third input, without gain but with an uncertainty of half a time step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import JOINTS
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation.dataset import prepare_dataset, sample_operating_region
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS, flatten_coefficients
from lagsplat.diagnose.residual.correlations import differentiate_clips
from lagsplat.diagnose.residual.latent_force import SmoothedMotion, smooth_motions
from lagsplat.diagnose.simulators.chain_dynamics import (
    ChainForces,
    compute_chain_forces,
    compute_own_force,
    simulate_alike,
)
from lagsplat.diagnose.simulators.mujoco_model import make_mujoco_fields, warn_of_omissions
from lagsplat.diagnose.simulators.projection import FieldFunctions, project_fields
from lagsplat.io.mujoco.model import MujocoSelection
from lagsplat.io.mujoco.package import require_mujoco
from lagsplat.io.trajectory.trajectory import Trajectory

COUPLING, RATE = "coupling of {}", "rate of {}"
"""Names of the computed inputs of a joint: of its name, and of its motor's."""


@dataclass(frozen=True)
class JointModel:
    """One joint of a chain as a simulator of its own, with its recordings."""

    joint: str
    actuator: str
    channel: int  # of the actuator's input in the recordings of the chain
    sim: EstimatedSimulator
    inertia: float  # reference inertia `m`, in the units of the file
    motions: tuple[Trajectory, ...]
    nominal: tuple[Trajectory, ...]  # the same of a run of the file that moves alike, see `simulate_alike`


@dataclass(frozen=True)
class Motor:
    """An input that drives one joint alone: its channel, and its force over the input."""

    channel: int
    gain: float


def find_motors(chosen: MujocoSelection, q: Float64[np.ndarray, "N d"]) -> dict[int, Motor]:
    """The motor of each joint by the joint's number; joints without one are missing.

    A motor drives one joint, with the same gain at all poses ``q``, and nothing else drives this joint; it
    has neither a state nor a force that depends on the joint.
    """
    model, mujoco = chosen.model, require_mujoco()
    gains = make_mujoco_fields(chosen).input_map(q[:: max(1, len(q) // JOINTS.gain_poses)])  # (N, n_u, d)
    size = np.abs(gains).max(axis=0, initial=0.0)
    found = {}
    for channel, i in enumerate(chosen.at_u):
        driven = np.flatnonzero(size[channel] > JOINTS.gain_tolerance * size[channel].max())
        depends = (
            model.actuator_biastype[i] != int(mujoco.mjtBias.mjBIAS_NONE)
            or model.actuator_gaintype[i] != int(mujoco.mjtGain.mjGAIN_FIXED)
            or model.actuator_dyntype[i] != int(mujoco.mjtDyn.mjDYN_NONE)
        )
        if len(driven) != 1 or depends:
            continue
        joint = int(driven[0])
        alone = not np.delete(size[:, joint], channel).any()
        if alone and np.ptp(gains[:, channel, joint]) <= JOINTS.gain_tolerance * size[channel, joint]:
            found[joint] = Motor(channel, float(gains[0, channel, joint]))
    return found


def build_joint_models(
    path: Path,
    chosen: MujocoSelection,
    motors: Mapping[int, Motor],
    motions: Sequence[Trajectory],
    *,
    hold: str,
) -> tuple[JointModel, ...]:
    """A model for every chosen joint that moves, with a warning of what the file has beyond them.

    Args:
        path, chosen: the MuJoCo file and its joints and actuators; contacts are switched off in it.
        motors: the motor of each of the joints, as `find_motors` gives them.
        motions: recordings of all of them.
        hold: "zoh" where inputs are held between samples, else "linear".
    """
    ready = prepare_dataset(motions, period_s=estimate_spectral_period_s(motions))
    warn_of_omissions(path, chosen, sample_operating_region(ready.dataset))
    chosen.model.opt.disableflags |= int(require_mujoco().mjtDisableBit.mjDSBL_CONTACT)
    count = len(chosen.joints)
    moving = np.flatnonzero(np.ptp(np.concatenate([motion.q for motion in motions]), axis=0)).tolist()
    periods_s = [1.0] * count  # those of joints that never move are of no account
    for i in moving:
        periods_s[i] = estimate_spectral_period_s([_pick_coordinate(motion, i) for motion in motions])
    real = _measure_chain(chosen, motions, periods_s)
    channels, gains = [motors[i].channel for i in range(count)], [motors[i].gain for i in range(count)]
    nominal = []
    for motion, force in simulate_alike(path, chosen, motions, [each.smooth for each in real], hold=hold):
        u = np.zeros_like(motion.u)
        u[:, channels] = force / gains
        nominal.append(replace(motion, u=u))
    run = _measure_chain(chosen, nominal, periods_s)
    return tuple(_build_joint_model(path, chosen, real, run, i, motors[i], hold) for i in moving)


@dataclass(frozen=True)
class _ChainMotion:
    """A recording of a chain, what it is without noise, and the forces along it."""

    motion: Trajectory
    smooth: SmoothedMotion
    forces: ChainForces

    def pick(self, joint: int, channel: int, names: tuple[str, str], inertia: float, hold: str) -> Trajectory:
        """The recording of one joint, with its motor's input and the coupling as inputs."""
        motion, forces, torque = self.motion, self.forces, self.motion.u[:, channel]
        coupling = inertia * self.smooth.a[:, joint] - forces.required[:, joint] - forces.own[:, joint]
        if hold == "zoh":
            coupling = average_held(coupling, motion)
        u = np.stack([torque, coupling, compute_input_rate(torque, motion, hold=hold)], axis=1)
        u_names = (names[1], COUPLING.format(names[0]), RATE.format(names[1]))
        alone = _pick_coordinate(motion, joint)
        return replace(alone, u=u, u_names=u_names, computed=u_names[1:], q_names=names[:1])


def _measure_chain(
    chosen: MujocoSelection, motions: Sequence[Trajectory], periods_s: Sequence[float]
) -> list[_ChainMotion]:
    smoothed = smooth_motions(motions, periods_s=periods_s)
    return [
        _ChainMotion(motion, smooth, compute_chain_forces(chosen, smooth))
        for motion, smooth in zip(motions, smoothed, strict=True)
    ]


def _build_joint_model(
    path: Path,
    chosen: MujocoSelection,
    real: Sequence[_ChainMotion],
    run: Sequence[_ChainMotion],
    joint: int,
    motor: Motor,
    hold: str,
) -> JointModel:
    names = (chosen.joints[joint], chosen.actuators[motor.channel])
    inertia = float(np.median(np.concatenate([each.forces.inertia[:, joint] for each in real])))
    motions, nominal = (
        tuple(each.pick(joint, motor.channel, names, inertia, hold) for each in side) for side in (real, run)
    )
    ready = prepare_dataset((*motions, *nominal), period_s=estimate_spectral_period_s(motions))
    region = sample_operating_region(ready.dataset)
    fields = _make_joint_fields(chosen, joint, inertia, motor.gain)
    model = project_fields(fields, region, what=f"{path.name}, joint {names[0]}").model
    shift = np.zeros_like(model.input_map)
    shift[0, 2] = 0.5 * float(chosen.model.opt.timestep) * model.input_map[0, 0]
    unchanged = {name: np.zeros_like(getattr(model, name)) for name in COEFFICIENT_FIELDS}
    direction = flatten_coefficients(replace(model, **{**unchanged, "input_map": shift}))
    sim = replace(EstimatedSimulator.exact(model), uncertainty_directions=direction[None])
    return JointModel(*names, motor.channel, sim, inertia, motions, nominal)


def compute_input_rate(u: Float64[np.ndarray, " T"], motion: Trajectory, *, hold: str) -> np.ndarray:
    """Rate of change of an input (T,) within each clip [its unit / s]; of a held one, from its sample on."""
    if hold == "zoh":
        return np.append(np.where(motion.joined, np.diff(u) / np.diff(motion.time_s), 0.0), 0.0)
    return differentiate_clips(u[:, None], motion)[:, 0]


def average_held(values: Float64[np.ndarray, " T"], motion: Trajectory) -> Float64[np.ndarray, " T"]:
    """The mean of a smooth signal from each sample to the next of its clip, as an input that is held."""
    ahead = np.arange(motion.n) + np.append(motion.joined, False)
    return 0.5 * (values + values[ahead])


def _pick_coordinate(motion: Trajectory, i: int) -> Trajectory:
    """The motion of one coordinate without inputs."""
    only, q, v = slice(i, i + 1), motion.q[:, [i]], None if motion.v is None else motion.v[:, [i]]
    names, resolution = motion.q_names[only], motion.resolution[only]
    nothing = np.zeros((motion.n, 0))
    return replace(motion, q=q, v=v, u=nothing, q_names=names, u_names=(), resolution=resolution)


def _make_joint_fields(chosen: MujocoSelection, joint: int, inertia: float, gain: float) -> FieldFunctions:
    dry = float(chosen.model.dof_frictionloss[chosen.at_v[joint]])

    def own(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return compute_own_force(chosen, joint, q[:, 0], v[:, 0])[:, None]

    return FieldFunctions(
        mass=lambda q: np.full((len(q), 1, 1), inertia),
        potential_gradient=lambda q: -own(q, np.zeros_like(q)),
        input_map=lambda q: np.tile([[[gain], [1.0], [0.0]]], (len(q), 1, 1)),
        dissipation=lambda q, v: own(q, np.zeros_like(q)) - own(q, v) + dry * np.sign(v),
    )
