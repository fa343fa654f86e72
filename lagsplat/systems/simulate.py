"""Simulate recordings of the arms under random pressures, with and without effects, and of mechanisms."""

from dataclasses import asdict, replace
from typing import Any, no_type_check

import numpy as np
from jaxtyping import UInt8
from numba import njit

from lagsplat.io.files.atomic import sha256_of_arrays
from lagsplat.io.recording.recording import Recording
from lagsplat.systems import chain
from lagsplat.systems.arm import Arm, build_arm
from lagsplat.systems.config import PlantedEffectConfig, ReleaseConfig, SimulationConfig
from lagsplat.systems.dynamics import Series, Vector, integrate_motion
from lagsplat.systems.pressures import draw_pressures, lag_input, spline_coefficients
from lagsplat.systems.release import simulate_release
from lagsplat.systems.rendering.painting import add_camera_noise, paint_arm, paint_board
from lagsplat.systems.truth import Truth, compute_truth

CHUNK_FRAMES = 1024
CREEP_RAD_S = 0.05  # rate from which dry friction is nearly full; below, it is viscous and can be integrated


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


def simulate(config: SimulationConfig, *, seed: int) -> tuple[Recording, Truth]:
    """Drive the arm at random, render its video and log the pressures.

    The recording holds what a laboratory would measure: frames with camera noise and pressures with gauge
    noise. Its ``states`` are None; the truth is returned separately. One seed gives one recording, bit for
    bit on one machine; pressures, gauge, camera and background have separate random streams, so that
    changing the image leaves the motion as it was. ``meta["sha256"]`` is that of frames and inputs.

    Raises:
        ValueError, RuntimeError: the arm has no rest pose, or its drive takes it out of its physical range.
    """
    drive, gauge, camera, background = _spawn_generators(seed)
    arm = build_arm(config.arm)
    pressures = draw_pressures(config, generator=drive)
    states, velocities = _move(arm, pressures, config)
    frames = _film(arm, states, config, camera=camera, background=background)
    recording = _make_recording(frames, pressures, config, gauge=gauge, seed=seed)
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


def simulate_planted(
    config: SimulationConfig, planted: PlantedEffectConfig, *, seed: int, scene: int
) -> Recording:
    """A recording of the arm with injected effects, before the background of the seed ``scene``.

    Its inputs are the commanded pressures with gauge noise; lagged pressures and effects are hidden. ``seed``
    is that of drive and noise.

    Raises:
        ValueError, RuntimeError: the arm has no rest pose, or is driven out of its physical range.
    """
    drive, gauge, camera, _ = _spawn_generators(seed)
    loads = [*config.arm.link_mass[:-1], config.arm.link_mass[-1] + planted.tip_mass]
    arm = build_arm(replace(config.arm, link_mass=loads))
    commanded = draw_pressures(config, generator=drive)
    lagged = lag_input(commanded, lag_s=planted.actuator_lag_s, dt_s=config.dt_s)
    friction = np.zeros(arm.d)
    friction[0::2] = planted.dry_friction * arm.table[:, chain.K_BEND]
    states, _ = _move(arm, lagged, config, friction=friction)
    frames = _film(arm, states, config, camera=camera, background=_spawn_generators(scene)[3])
    return _make_recording(frames, commanded, config, gauge=gauge, seed=seed, planted=asdict(planted))


def _spawn_generators(seed: int) -> list[np.random.Generator]:
    """Generators of pressures, gauge, camera and background."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4)]


def _move(
    arm: Arm, pressures: Series, config: SimulationConfig, *, friction: Vector | None = None
) -> tuple[Series, Series]:
    """States and velocities at the frames. The arm hangs at its rest pose until the first pressure."""
    rest, start = arm.equilibrium(np.zeros(arm.d)), config.rest_frames
    before = np.tile(rest, (start, 1))
    # The motion starts after rest, because an error estimate of exactly zero makes the solver divide by zero.
    states, velocities = integrate(
        arm,
        rest,
        np.zeros(arm.d),
        pressures[start:],
        dt_s=config.dt_s,
        rtol=config.rtol,
        atol=config.atol,
        friction=friction,
    )
    return np.concatenate([before, states]), np.concatenate([np.zeros_like(before), velocities])


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

    The ``pressures`` [atm] at the frames, ``dt_s`` [s] apart, are interpolated by a cubic spline;
    ``friction`` is the dry friction of each coordinate.

    Raises:
        RuntimeError: the solver failed, because the arm left its physical range.
    """
    drive = (spline_coefficients(pressures, dt_s=dt_s), dt_s, arm.table, arm.gravity)
    rate, args = (_rate, drive) if friction is None else (_rate_with_friction, (friction, *drive))
    time_s = np.arange(len(pressures)) * dt_s
    try:
        # `max_step_s` keeps the solver at rest from stepping over the beginning of the drive.
        return integrate_motion(rate, q, v, time_s, rtol=rtol, atol=atol, max_step_s=3 * dt_s, args=args)
    except (RuntimeError, np.linalg.LinAlgError) as error:
        raise RuntimeError(
            f"the arm was driven out of its physical range ({error}); lower simulation.drive_max_atm or "
            "planted.effects, or stiffen the arm"
        ) from error


@njit(cache=True)
@no_type_check
def _rate(t, state, spline, dt_s, table, gravity):
    """Velocities and accelerations of the arm under the spline of its pressures [atm]."""
    d = state.size // 2
    i = min(max(int(t / dt_s), 0), spline.shape[1] - 1)
    x = t - i * dt_s
    pressure = ((spline[0, i] * x + spline[1, i]) * x + spline[2, i]) * x + spline[3, i]
    q, v = state[:d], state[d:]
    out = np.empty(2 * d)
    out[:d] = v
    out[d:] = chain.acceleration(q, v, pressure, table, gravity)
    return out


@njit(cache=True)
@no_type_check
def _rate_with_friction(t, state, friction, spline, dt_s, table, gravity):
    d = state.size // 2
    q, v = state[:d], state[d:]
    out = _rate(t, state, spline, dt_s, table, gravity)
    rubbing = -friction * np.tanh(v / CREEP_RAD_S)
    out[d:] += np.linalg.solve(chain.chain_inertia(q, v, table, gravity)[0], rubbing)
    return out


def _film(
    arm: Arm,
    states: Series,
    config: SimulationConfig,
    *,
    camera: np.random.Generator,
    background: np.random.Generator,
) -> UInt8[np.ndarray, "T H W 3"]:
    """Frames of the arm in these states, with the noise of the camera."""
    board = paint_board(config, generator=background)
    frames = np.empty((len(states), *board.shape), np.uint8)
    for start in range(0, len(states), CHUNK_FRAMES):
        part = slice(start, start + CHUNK_FRAMES)
        clean = paint_arm(arm, states[part], config, board)
        frames[part] = add_camera_noise(clean, config.camera_noise_levels, camera)
    return frames


def _make_recording(
    frames: np.ndarray,
    pressures: Series,
    config: SimulationConfig,
    *,
    gauge: np.random.Generator,
    seed: int,
    **meta: Any,
) -> Recording:
    """The recording of these frames and of the pressures [atm] with the gauge's noise."""
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
