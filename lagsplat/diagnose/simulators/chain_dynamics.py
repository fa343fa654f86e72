"""Inverse dynamics of a MuJoCo chain along a measured motion, and a run of the file that moves alike.

Contacts, limits and equalities are left out of both, as in `mujoco_model`.

Source: the recursive Newton-Euler algorithm, Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 5, as
MuJoCo computes it; the run follows its motion by computed torque, Craig, "Introduction to Robotics", ch. 10.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.residual.latent_force import SmoothedMotion
from lagsplat.io.mujoco.model import MujocoSelection
from lagsplat.io.mujoco.package import require_mujoco
from lagsplat.io.trajectory.trajectory import Trajectory

HELD_INERTIA = 1e6  # inertia of joints that are no coordinates, over the largest of those that are
TRACKING_SAMPLES = 10.0  # samples in which the followed motion is reached, over 1 rad of its control loop


@dataclass(frozen=True)
class ChainForces:
    """Forces on the chosen joints along a motion, in the units of the file."""

    required: Float64[np.ndarray, "T d"]  # what has to act beside the file's springs, dampers and gravity
    own: Float64[np.ndarray, "T d"]  # spring and damper of each joint itself, which are part of that already
    inertia: Float64[np.ndarray, "T d"]  # diagonal of the mass matrix


def compute_chain_forces(chosen: MujocoSelection, motion: SmoothedMotion) -> ChainForces:
    """The inverse dynamics of a motion without friction loss.

    Joints that are not chosen rest where the data of ``chosen`` have them.
    """
    states = zip(motion.q, motion.v, motion.a, strict=True)
    required, mass = map(np.array, zip(*(_invert_dynamics(chosen, *state) for state in states), strict=True))
    columns = enumerate(zip(motion.q.T, motion.v.T, strict=True))
    own = [compute_own_force(chosen, joint, q, v) for joint, (q, v) in columns]
    return ChainForces(required, np.stack(own, axis=1), np.diagonal(mass, axis1=1, axis2=2))


def _invert_dynamics(
    chosen: MujocoSelection, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[Float64[np.ndarray, " d"], Float64[np.ndarray, "d d"]]:
    """Force on the chosen joints that gives the acceleration ``a``, and the mass matrix."""
    chosen.set_state(q, v)
    mass = chosen.measure_mass()[np.ix_(chosen.at_v, chosen.at_v)]
    return mass @ a + (chosen.data.qfrc_bias - chosen.data.qfrc_passive)[chosen.at_v], mass


def compute_own_force(
    chosen: MujocoSelection, joint: int, q: Float64[np.ndarray, " N"], v: Float64[np.ndarray, " N"]
) -> Float64[np.ndarray, " N"]:
    """Spring and damper of one joint, while all others rest in the reference pose of the file."""
    mujoco, model, data = require_mujoco(), chosen.model, chosen.data
    at_q, at_v, before = chosen.at_q[joint], chosen.at_v[joint], data.qpos.copy()
    data.qpos[:], data.qvel[:] = model.qpos0, 0.0
    force = np.empty(len(q))
    for k, (position, rate) in enumerate(zip(q, v, strict=True)):
        data.qpos[at_q], data.qvel[at_v] = position, rate
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        force[k] = data.qfrc_spring[at_v] + data.qfrc_damper[at_v]
    data.qpos[:] = before
    return force


def simulate_alike(
    path: Path,
    chosen: MujocoSelection,
    motions: Sequence[Trajectory],
    smoothed: Sequence[SmoothedMotion],
    *,
    hold: str,
) -> list[tuple[Trajectory, Float64[np.ndarray, "T d"]]]:
    """Recordings that the file itself would give of these motions, each with the force on every joint (T, d).

    A controller makes MuJoCo follow the motions, by the time step and the integrator of the file; noise is
    added, as large as what smoothing removed. What is computed from such a recording shows what errors of
    integration and smoothing amount to.

    Args:
        path, chosen: the file, and its joints.
        motions, smoothed: the motions and what they are without noise.
        hold: whether forces are held between samples ("zoh") or linear.
    """
    rng = np.random.default_rng(0)
    follower = _make_follower(chosen)
    removed = [motion.q - aim.q for motion, aim in zip(motions, smoothed, strict=True)]
    sigma = np.sqrt(np.mean(np.concatenate(removed) ** 2, axis=0))
    made = []
    for motion, aim in zip(motions, smoothed, strict=True):
        q, force = np.empty((motion.n, motion.d)), np.empty((motion.n, motion.d))
        for start, stop in motion.segments:
            clip = slice(start, stop)
            part = SmoothedMotion(aim.q[clip], aim.v[clip], aim.a[clip])
            q[clip], force[clip] = _follow(follower, chosen, motion.time_s[clip], part, hold=hold)
        noisy = q + sigma * rng.standard_normal(q.shape)
        made.append((replace(motion, q=noisy, v=None, source=f"{path.name} alike"), force))
    return made


def _make_follower(chosen: MujocoSelection) -> MujocoSelection:
    """The model once more, with all that the diagnosis leaves out switched off and other joints held."""
    mujoco = require_mujoco()
    model, off = copy.deepcopy(chosen.model), mujoco.mjtDisableBit
    follower = replace(chosen, model=model, data=mujoco.MjData(model))
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, follower.data, 0)
    for flag in (off.mjDSBL_CONTACT, off.mjDSBL_LIMIT, off.mjDSBL_EQUALITY, off.mjDSBL_ACTUATION):
        model.opt.disableflags |= int(flag)
    others = np.setdiff1d(np.arange(model.nv), follower.at_v)
    if others.size:
        mujoco.mj_forward(model, follower.data)
        model.dof_armature[others] = HELD_INERTIA * np.diagonal(follower.measure_mass()).max()
    return follower


def _follow(
    follower: MujocoSelection, chosen: MujocoSelection, time_s: np.ndarray, aim: SmoothedMotion, *, hold: str
) -> tuple[Float64[np.ndarray, "n d"], Float64[np.ndarray, "n d"]]:
    """Coordinates and forces of a run that follows ``aim``; each force is decided a sample ahead."""
    mujoco, model, data = require_mujoco(), follower.model, follower.data
    at_q, at_v, rest = follower.at_q, follower.at_v, follower.data.qpos.copy()
    n = len(time_s)
    step_s = float(model.opt.timestep)
    rate = 1.0 / (TRACKING_SAMPLES * float(np.median(np.diff(time_s))))
    q, force = np.empty(aim.q.shape), np.empty(aim.q.shape)
    follower.set_state(aim.q[0], aim.v[0])
    now = _invert_dynamics(chosen, aim.q[0], aim.v[0], aim.a[0])[0]
    for k in range(n):
        q[k], force[k] = data.qpos[at_q], now
        if k == n - 1:
            break
        away, drift = aim.q[k] - data.qpos[at_q], aim.v[k] - data.qvel[at_v]
        pull = aim.a[k + 1] + rate**2 * away + 2.0 * rate * drift
        then = _invert_dynamics(chosen, aim.q[k + 1], aim.v[k + 1], pull)[0]
        ahead_s = float(time_s[k + 1] - time_s[k])
        count = max(1, round(ahead_s / step_s))
        model.opt.timestep = ahead_s / count
        for i in range(count):
            share = 0.0 if hold == "zoh" else (i + 0.5) / count
            data.qfrc_applied[at_v] = now + share * (then - now)
            mujoco.mj_step(model, data)
        now = then
    model.opt.timestep = step_s
    mujoco.mj_resetData(model, data)
    data.qpos[:] = rest
    return q, force
