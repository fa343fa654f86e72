"""Simulate a recording of a released mechanism (motion, video, truth), and draw chamber pressures."""

from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline

from lagsplat.io.files.atomic import sha256_of_arrays
from lagsplat.io.recording.recording import Recording
from lagsplat.systems.config import PushConfig, ReleaseConfig, SimulationConfig
from lagsplat.systems.mechanism import (
    Mechanism,
    Push,
    compute_free_modes,
    find_rest_state,
    make_mechanism,
    release_from_rest,
)
from lagsplat.systems.truth import STEP, Series, Truth, Vector, compute_truth
from lagsplat.systems.video import film_clips


def simulate_release(config: ReleaseConfig, *, seed: int) -> tuple[Recording, Truth]:
    """Release the mechanism once per clip, record a video of each, and read the videos back.

    One seed gives one recording, bit for bit on one machine with one build of OpenCV. Only the camera draws
    random numbers, so the image size does not change the motion.

    Raises:
        ValueError: the mechanism has no rest state, or OpenCV cannot write the codec.
        RuntimeError: the motion cannot be integrated.
    """
    mechanism = make_mechanism(config)
    motions = [_move(mechanism, config, i) for i in range(len(config.clips))]
    states, velocities, forces = (np.concatenate(part) for part in zip(*motions, strict=True))
    recording = film_clips(config, [mechanism.poses(clip[0]) for clip in motions], seed=seed)
    looks = " and ".join(body.shape for body in config.bodies)
    recording = replace(
        recording,
        meta={
            "origin": "simulated",
            "source": f"lagsplat.systems.release, {looks}, seed {seed}",
            "sha256": sha256_of_arrays(recording.frames),
            "licence": "BSD-3-Clause",
            "simulation": asdict(config),
            "seed": seed,
            "footage": recording.meta["footage"],
        },
    )
    truth = compute_truth(
        mechanism,
        states,
        velocities,
        pressures=recording.inputs,
        forces=forces,
        rest=find_rest_state(mechanism),
        modes=compute_free_modes(mechanism),
    )
    return recording, truth


def _move(mechanism: Mechanism, config: ReleaseConfig, index: int) -> tuple[Series, Series, Series]:
    """States, velocities and external generalised forces at the frames of one clip."""
    clip = config.clips[index]
    time_s = np.arange(clip.n_frames) * config.dt_s
    push = _pulses(mechanism, [push for push in config.pushes if push.clip == index])
    states, velocities = release_from_rest(
        mechanism, np.array(clip.state), np.array(clip.velocity), time_s=time_s, push=push, rtol=config.rtol
    )
    return states, velocities, np.array([push(t, q) for t, q in zip(time_s, states, strict=True)])


def _pulses(mechanism: Mechanism, pushes: list[PushConfig]) -> Push:
    def force(time_s: float, q: Vector) -> Vector:
        total = np.zeros(len(q))
        for push in pushes:
            share = (time_s - push.start_s) / (push.stop_s - push.start_s)
            if 0 < share < 1:
                reach = compute_jacobian(mechanism, q, push.body, np.array(push.at_m))
                total += np.sin(np.pi * share) ** 2 * np.array(push.force_n) @ reach
        return total

    return force


def compute_jacobian(
    mechanism: Mechanism, q: Vector, body: int, at_m: Float64[np.ndarray, "2"]
) -> Float64[np.ndarray, "2 d"]:
    """Derivative of a body's point ``at_m`` [m], in the body's coordinates, with respect to ``q``."""
    nearby = q + STEP * np.concatenate([np.eye(len(q)), -np.eye(len(q))])
    x, y, angle = mechanism.poses(nearby)[:, body].T
    offset = (at_m[0] + 1j * at_m[1]) * np.exp(1j * angle)
    ahead, behind = np.split(np.stack([x + offset.real, y + offset.imag]), 2, axis=1)
    return (ahead - behind) / (2 * STEP)


RELEASE_FRAMES = 8


def draw_random_band(
    n_frames: int,
    n_inputs: int,
    *,
    dt_s: float,
    low_hz: float,
    high_hz: float,
    generator: np.random.Generator,
) -> Float64[np.ndarray, "n_frames n_inputs"]:
    """Independent Gaussian signals of unit variance, zero outside the band, amplitude falling as 1/f inside.

    The signal is a part of one with at least four periods of the lowest frequency, so that a short signal
    still has a nearly continuous spectrum.
    """
    period = max(n_frames, int(np.ceil(4 / (low_hz * dt_s))))
    frequency = np.fft.rfftfreq(period, dt_s)
    inside = (frequency >= low_hz) & (frequency <= high_hz)
    amplitude = np.where(inside, 1 / np.where(inside, frequency, 1.0), 0.0)
    shape = (frequency.size, n_inputs)
    spectrum = generator.standard_normal(shape) + 1j * generator.standard_normal(shape)
    spectrum *= amplitude[:, None] * period / (2 * np.sqrt(np.sum(amplitude**2)))
    return np.fft.irfft(spectrum, n=period, axis=0)[:n_frames]


def _smooth_step(n_frames: int, *, start: int, length: int) -> Float64[np.ndarray, " n_frames"]:
    """0 up to ``start``, 1 from ``start + length``, twice continuously differentiable between."""
    x = np.clip((np.arange(n_frames) - start) / length, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def draw_pressures(
    config: SimulationConfig, *, generator: np.random.Generator
) -> Float64[np.ndarray, "n_frames n_inputs"]:
    """The true pressures at the frames [atm], one column per chamber.

    Zero for ``rest_frames``; a smooth start over ``hold_frames``; the drive ``max (1 + tanh(0.6 x)) / 2``,
    which keeps 90 % of the samples within 0.12-0.88 of the maximum; a blend into ``hold_atm`` over
    ``hold_frames``; released within eight frames from frame ``n_frames - tail_frames`` on.
    """
    n, release = config.n_frames, config.n_frames - config.tail_frames
    band = {"low_hz": config.drive_low_hz, "high_hz": config.drive_high_hz}
    signal = draw_random_band(n, len(config.hold_atm), dt_s=config.dt_s, **band, generator=generator)
    drive = 0.5 * config.drive_max_atm * (1 + np.tanh(0.6 * signal))
    start = _smooth_step(n, start=config.rest_frames, length=config.hold_frames)
    hold = _smooth_step(n, start=release - config.hold_frames, length=config.hold_frames)
    end = _smooth_step(n, start=release, length=RELEASE_FRAMES)
    blended = drive * (1 - hold)[:, None] + np.asarray(config.hold_atm) * hold[:, None]
    return blended * (start * (1 - end))[:, None]


def spline_coefficients(
    pressures: Float64[np.ndarray, "n_frames n_inputs"], *, dt_s: float
) -> Float64[np.ndarray, "4 n_intervals n_inputs"]:
    """Cubic spline through the pressures at the frames, as the arm receives them; powers from 3 down to 0."""
    return np.ascontiguousarray(CubicSpline(np.arange(len(pressures)) * dt_s, pressures, bc_type="natural").c)
