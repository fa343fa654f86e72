"""A simulated recording of a pneumatic arm, and the truth behind it."""

from dataclasses import asdict

import numpy as np
from jaxtyping import Float64, UInt8

from lagsplat.io.checksum import sha256_of_arrays
from lagsplat.io.recording import Recording
from lagsplat.systems.arm import Arm, build_arm
from lagsplat.systems.config import SimulationConfig
from lagsplat.systems.drive import draw_pressures
from lagsplat.systems.paint import Board, paint, paint_board
from lagsplat.systems.trajectory import integrate
from lagsplat.systems.truth import Truth, truth_of

CHUNK_FRAMES = 1024


def simulate(config: SimulationConfig, *, seed: int) -> tuple[Recording, Truth]:
    """Drive the arm at random, film it, log the pressures.

    The recording holds what a laboratory would have: frames with camera noise and pressures with gauge
    noise. Its ``states`` are None; the truth is apart. One seed gives one recording, bit for bit on one
    machine; pressures, gauge, camera and background draw from streams of their own, so that changing the
    picture leaves the motion as it was. ``meta["sha256"]`` is that of the frames' and the inputs' bytes.

    Raises:
        ValueError, RuntimeError: the arm has no rest pose, or its drive takes it out of its physical range.
    """
    drive, gauge, camera, scene = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
    arm = build_arm(config.arm)
    pressures = draw_pressures(config, generator=drive)
    states, velocities = _move(arm, pressures, config=config)
    board = paint_board(
        height=config.height, width=config.width, arm_share=config.arm.half_width / config.view_width,
        generator=scene,
    )  # fmt: skip
    frames = film(states, arm=arm, board=board, config=config, generator=camera)
    inputs = pressures + config.pressure_noise_atm * gauge.standard_normal(pressures.shape)
    n_u = pressures.shape[1]
    recording = Recording(
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
            "seed": seed,
        },
    )
    truth = truth_of(
        arm,
        states,
        velocities,
        pressures=pressures,
        forces=np.zeros_like(states),
        rest=arm.equilibrium(np.zeros(arm.d)),
        modes=arm.modes(),
    )
    return recording, truth


def film(
    states: Float64[np.ndarray, "T d"],
    *,
    arm: Arm,
    board: Board,
    config: SimulationConfig,
    generator: np.random.Generator,
) -> UInt8[np.ndarray, "T H W 3"]:
    """Frames as the camera delivers them: Gaussian noise of ``camera_noise_levels``, then rounding."""
    frames = np.empty((len(states), *board.shape), np.uint8)
    for start in range(0, len(states), CHUNK_FRAMES):
        part = slice(start, start + CHUNK_FRAMES)
        clean = paint(
            states[part], arm=arm, half_width=config.arm.half_width, view_width=config.view_width, board=board
        )
        noise = generator.standard_normal(clean.shape, dtype=np.float32)
        levels = 255 * clean + np.float32(config.camera_noise_levels) * noise
        frames[part] = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    return frames


def _move(
    arm: Arm, pressures: Float64[np.ndarray, "T n_u"], *, config: SimulationConfig
) -> tuple[Float64[np.ndarray, "T d"], Float64[np.ndarray, "T d"]]:
    """States and velocities at the frames. The arm hangs at its rest pose until the first pressure."""
    rest = arm.equilibrium(np.zeros(arm.d))
    # An error estimate of exactly zero makes the solver divide zero by zero, hence not from the first frame.
    start = config.rest_frames
    states, velocities = np.tile(rest, (len(pressures), 1)), np.zeros((len(pressures), arm.d))
    states[start:], velocities[start:] = integrate(
        arm, rest, np.zeros(arm.d), pressures[start:], dt_s=config.dt_s, rtol=config.rtol, atol=config.atol
    )
    return states, velocities
