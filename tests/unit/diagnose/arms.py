"""Robot arms in MuJoCo that a controller moves, with any fault, and what was logged of them."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lagsplat.io.trajectory.trajectory import Trajectory

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 1 0")
LENGTHS, MASSES = (0.15, 0.3, 0.25, 0.12, 0.12, 0.08, 0.06), (2.0, 2.0, 1.5, 1.0, 0.8, 0.5, 0.3)
NOISE = 2e-4  # rad
Fault = Callable[[float, np.ndarray], np.ndarray]
"""From the time [s] and the logged torques to those that act."""


def write_arm(
    path: Path,
    n: int,
    *,
    damping: Sequence[float] = (),
    friction: Sequence[float] = (),
    actuators: Sequence[str] | None = None,
) -> Path:
    """Write an upright arm of ``n`` joints j0, j1, ... with the motors m0, m1, ...; return the path."""
    bodies, ends = "", ""
    for i in range(n):
        rub = 0.1 + (damping[i] if i < len(damping) else 0.0)
        dry = friction[i] if i < len(friction) else 0.0
        bodies += f"""<body pos="0 0 {LENGTHS[i - 1] if i else 0.1}">
        <joint name="j{i}" axis="{AXES[i]}" damping="{rub}" frictionloss="{dry}" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.02 0.01 {LENGTHS[i]}" size="0.03" mass="{MASSES[i]}"/>"""
        ends += "</body>"
    motors = actuators or [f'<motor name="m{i}" joint="j{i}" gear="{1 + i}"/>' for i in range(n)]
    path.write_text(
        '<mujoco><option timestep="0.0005" integrator="implicitfast"><flag contact="disable"/></option>'
        f"<worldbody>{bodies}{ends}</worldbody><actuator>{''.join(motors)}</actuator></mujoco>"
    )
    return path


def record_arm(
    path: Path, duration_s: float, *, seed: int, fault: Fault | None = None, rate_hz: int = 100
) -> Trajectory:
    """Joint angles and motor inputs of an arm that follows sums of sines by computed torque."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data, n, rng = mujoco.MjData(model), model.nu, np.random.default_rng(seed)
    hertz, phase = rng.uniform(0.15, 0.8, (n, 4)), rng.uniform(0.0, 2.0 * np.pi, (n, 4))
    size, gear = rng.uniform(0.1, 0.35, (n, 4)), model.actuator_gear[:, 0]
    substeps, mass = round(1.0 / rate_hz / model.opt.timestep), np.zeros((n, n))
    time_s, q, u = [], [], []
    for k in range(round(duration_s * rate_hz)):
        angle = 2.0 * np.pi * hertz * k / rate_hz + phase
        aim = (size * (np.sin(angle) - np.sin(phase))).sum(axis=1)
        mujoco.mj_fullM(model, data, mass)
        torque = mass @ (60.0 * (aim - data.qpos) - 12.0 * data.qvel) + data.qfrc_bias
        time_s.append(k / rate_hz)
        q.append(data.qpos.copy())
        u.append(torque / gear)
        for i in range(substeps):
            now = time_s[-1] + i * model.opt.timestep
            data.ctrl[:] = u[-1] if fault is None else fault(now, u[-1])
            mujoco.mj_step(model, data)
    measured = np.array(q) + NOISE * rng.standard_normal((len(q), n))
    names = [tuple(f"{letter}{i}" for i in range(n)) for letter in "qu"]
    return Trajectory(
        np.array(time_s), measured, np.array(u), q_names=names[0], u_names=names[1], source="log.csv"
    )


def write_log(path: Path, motion: Trajectory) -> Path:
    """Write a recording as a table."""
    header = ",".join(["t", *motion.q_names, *motion.u_names])
    rows = np.column_stack([motion.time_s, motion.q, motion.u])
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return path
