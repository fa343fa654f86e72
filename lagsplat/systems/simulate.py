"""Simulate recordings of the arms under random pressures, with and without effects, and of mechanisms."""

from dataclasses import asdict, replace
from typing import Any, no_type_check

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp
from scipy.signal import lsim, lti

from lagsplat.io.files.atomic import sha256_of_arrays
from lagsplat.io.recording.recording import Recording
from lagsplat.systems import chain
from lagsplat.systems.arm import Arm, build_arm
from lagsplat.systems.config import PlantedConfig, ReleaseConfig, SimulationConfig
from lagsplat.systems.release import draw_pressures, simulate_release, spline_coefficients
from lagsplat.systems.rendering.painting import paint_arm, paint_board
from lagsplat.systems.truth import Series, Truth, Vector, compute_truth

CHUNK_FRAMES = 1024


def simulate(config: SimulationConfig, *, seed: int) -> tuple[Recording, Truth]:
    """Drive the arm at random, render its video and log the pressures.

    The recording holds what a laboratory would measure: frames with camera noise and pressures with gauge
    noise. Its ``states`` are None; the truth is returned separately. One seed gives one recording, bit for
    bit on one machine; pressures, gauge, camera and background have separate random streams, so that
    changing the image leaves the motion as it was. ``meta["sha256"]`` is that of frames and inputs.

    Raises:
        ValueError, RuntimeError: the arm has no rest pose, or its drive takes it out of its physical range.
    """
    drive, gauge, camera, scene = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
    arm = build_arm(config.arm)
    pressures = draw_pressures(config, generator=drive)
    states, velocities = _move(arm, pressures, config)
    recording = _film_recording(
        states, pressures, arm=arm, config=config, gauge=gauge, camera=camera, painter=scene, seed=seed
    )
    truth = compute_truth(
        arm,
        states,
        velocities,
        pressures=pressures,
        forces=np.zeros_like(states),
        rest=arm.equilibrium(np.zeros(arm.d)),
        modes=arm.modes(),
    )
    return recording, truth


def _film_recording(
    states: Series,
    pressures: Series,
    *,
    arm: Arm,
    config: SimulationConfig,
    gauge: np.random.Generator,
    camera: np.random.Generator,
    painter: np.random.Generator,
    seed: int,
    **meta: Any,
) -> Recording:
    """Film the states, and log the pressures [atm] with the gauge's noise; ``meta`` joins the metadata."""
    board = paint_board(
        height=config.height,
        width=config.width,
        arm_share=config.arm.half_width / config.view_width,
        generator=painter,
    )
    frames = np.empty((len(states), *board.shape), np.uint8)
    for start in range(0, len(states), CHUNK_FRAMES):
        part = slice(start, start + CHUNK_FRAMES)
        clean = paint_arm(
            states[part], arm=arm, half_width=config.arm.half_width, view_width=config.view_width, board=board
        )
        noise = camera.standard_normal(clean.shape, dtype=np.float32)
        levels = 255 * clean + np.float32(config.camera_noise_levels) * noise
        frames[part] = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    inputs = pressures + config.pressure_noise_atm * gauge.standard_normal(pressures.shape)
    n_u = pressures.shape[1]
    return Recording(
        frames=frames,
        time_s=np.arange(config.n_frames) * config.dt_s,
        inputs=inputs,
        input_names=tuple(f"p{i + 1}" for i in range(n_u)),
        input_units=("atm",) * n_u,
        meta={
            "origin": "simulated",
            "source": f"lagsplat.systems.simulate, {n_u // 2} segment(s), seed {seed}",
            "sha256": sha256_of_arrays(frames, inputs),
            "licence": "BSD-3-Clause",
            "simulation": asdict(config),
            **meta,
            "seed": seed,
        },
    )


def _move(
    arm: Arm, pressures: Series, config: SimulationConfig, *, friction: Vector | None = None
) -> tuple[Series, Series]:
    """States and velocities at the frames. The arm hangs at its rest pose until the first pressure."""
    rest = arm.equilibrium(np.zeros(arm.d))
    # The motion starts after rest, because an error estimate of exactly zero makes the solver divide by zero.
    start = config.rest_frames
    tolerances = {"rtol": config.rtol, "atol": config.atol}
    states, velocities = np.tile(rest, (len(pressures), 1)), np.zeros((len(pressures), arm.d))
    states[start:], velocities[start:] = integrate(
        arm, rest, np.zeros(arm.d), pressures[start:], dt_s=config.dt_s, friction=friction, **tolerances
    )
    return states, velocities


def simulate_system(
    driven: SimulationConfig | None, released: ReleaseConfig | None, *, seed: int
) -> tuple[Recording, Truth]:
    """The recording of a driven arm or of a released mechanism, and its truth.

    Raises:
        ValueError: neither is given, or as `simulate` and `simulate_release`.
    """
    if driven is not None:
        return simulate(driven, seed=seed)
    if released is not None:
        return simulate_release(released, seed=seed)
    raise ValueError("the system has neither a simulation nor a release; choose recording=filmed")


def resize_simulation(
    driven: SimulationConfig | None, released: ReleaseConfig | None, *, height: int, width: int
) -> tuple[SimulationConfig | None, ReleaseConfig | None]:
    """The same motion in frames of ``height`` by ``width`` [px]; the video keeps its size if it can."""
    if driven is not None:
        driven = replace(driven, height=height, width=width)
    if released is not None:
        scale = max(1, round(released.scene.film_scale * released.height / height))
        scene = replace(released.scene, film_scale=scale)
        released = replace(released, height=height, width=width, scene=scene)
    return driven, released


@njit(cache=True)
@no_type_check
def choose_rate(t, state, spline, dt_s, table, nodes, weights, gravity):
    """Velocities and accelerations of the arm under the spline of its pressures [atm]."""
    d = state.size // 2
    i = min(max(int(t / dt_s), 0), spline.shape[1] - 1)
    x = t - i * dt_s
    pressure = ((spline[0, i] * x + spline[1, i]) * x + spline[2, i]) * x + spline[3, i]
    q, v = state[:d], state[d:]
    out = np.empty(2 * d)
    out[:d] = v
    out[d:] = chain.acceleration(q, v, pressure, table, nodes, weights, gravity)
    return out


def integrate(
    arm: Arm,
    q: Vector,
    v: Vector,
    pressures: Series,
    *,
    dt_s: float,
    rtol: float,
    atol: float,
    friction: Vector | None = None,
) -> tuple[Series, Series]:
    """Coordinates and velocities at the frames, from the state ``(q, v)`` at the first one.

    Args:
        arm, q, v: the arm, and its initial state.
        pressures, dt_s: inputs [atm] at the frames, interpolated by a cubic spline, and their spacing [s].
        rtol, atol: tolerances of the solver.
        friction: dry friction of each coordinate; None is none.

    Raises:
        RuntimeError: the solver failed, because the arm left its physical range.

    Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (DOP853).
    """
    mechanics = (arm.table, arm.nodes, arm.weights, arm.gravity)
    drive = (spline_coefficients(pressures, dt_s=dt_s), dt_s)
    times = np.arange(len(pressures)) * dt_s
    try:
        # `max_step` keeps the solver at rest from stepping over the beginning of the drive.
        solution = solve_ivp(
            choose_rate if friction is None else _rate_with_friction,
            (0.0, times[-1]),
            np.concatenate([q, v]),
            method="DOP853",
            t_eval=times,
            rtol=rtol,
            atol=atol,
            max_step=3 * dt_s,
            args=(*drive, *mechanics) if friction is None else (*drive, friction, *mechanics),
        )
    except np.linalg.LinAlgError as error:
        raise _out_of_range("the mass matrix is no longer finite") from error
    if not solution.success or not np.all(np.isfinite(solution.y)):
        raise _out_of_range(f"at t = {solution.t[-1]:.3f} s, {solution.message}")
    states = np.ascontiguousarray(solution.y.T)
    return states[:, : arm.d].copy(), states[:, arm.d :].copy()


def _out_of_range(reason: str) -> RuntimeError:
    return RuntimeError(
        f"integration of the arm stopped ({reason}): it was driven out of its physical range; lower "
        "simulation.drive_max_atm or planted.effects, or stiffen the arm"
    )


CREEP_RAD_S = 0.05
"""Bending rate at which dry friction is nearly full; below, it is viscous and can be integrated."""


def simulate_planted(config: SimulationConfig, planted: PlantedConfig, *, seed: int, scene: int) -> Recording:
    """A recording of the arm with injected effects, before the background of the seed ``scene``.

    Its inputs are the commanded pressures with gauge noise; lagged pressures and effects are hidden. ``seed``
    is that of drive and noise.

    Raises:
        ValueError, RuntimeError: the arm has no rest pose, or is driven out of its physical range.
    """
    drive, gauge, camera = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    painter = np.random.default_rng(np.random.SeedSequence(scene).spawn(4)[3])
    loads = [*config.arm.link_mass[:-1], config.arm.link_mass[-1] + planted.tip_mass]
    arm = build_arm(replace(config.arm, link_mass=loads))
    commanded = draw_pressures(config, generator=drive)
    lagged = lag_input(commanded, lag_s=planted.actuator_lag_s, dt_s=config.dt_s)
    friction = np.zeros(arm.d)
    friction[0::2] = planted.dry_friction * arm.table[:, chain.K_BEND]
    states, _ = _move(arm, lagged, config, friction=friction)
    return _film_recording(
        states,
        commanded,
        arm=arm,
        config=config,
        gauge=gauge,
        camera=camera,
        painter=painter,
        seed=seed,
        planted=asdict(planted),
    )


def lag_input(pressures: Series, *, lag_s: float, dt_s: float) -> Series:
    """Pressures behind a first-order lag, exact for piecewise linear inputs; unchanged without lag."""
    if lag_s == 0.0:
        return pressures
    times = dt_s * np.arange(len(pressures))
    columns = [lsim(lti([1.0], [lag_s, 1.0]), column, times)[1] for column in pressures.T]
    return np.stack(columns, axis=1)


@njit(cache=True)
@no_type_check
def _rate_with_friction(t, state, spline, dt_s, friction, table, nodes, weights, gravity):
    d = state.size // 2
    q, v = state[:d], state[d:]
    out = choose_rate(t, state, spline, dt_s, table, nodes, weights, gravity)
    rubbing = -friction * np.tanh(v / CREEP_RAD_S)
    out[d:] += np.linalg.solve(chain.chain_inertia(q, v, table, nodes, weights, gravity)[0], rubbing)
    return out
