"""Simulate a recording of a released mechanism: its motion, its video and its truth."""

from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.io.files.atomic import sha256_of_arrays
from lagsplat.io.recording.recording import Recording
from lagsplat.systems.config import ReleaseConfig
from lagsplat.systems.dynamics import Series, Vector, differentiate
from lagsplat.systems.mechanism import Mechanism, compute_free_modes, find_rest_state, make_mechanism, release
from lagsplat.systems.truth import Truth, compute_truth
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
    pulses = [push for push in config.pushes if push.clip == index]

    def push(time_s: float, q: Vector) -> Vector:
        total = np.zeros(len(q))
        for pulse in pulses:
            share = (time_s - pulse.start_s) / (pulse.stop_s - pulse.start_s)
            if 0 < share < 1:
                reach = compute_jacobian(mechanism, q, pulse.body, np.array(pulse.at_m))
                total += np.sin(np.pi * share) ** 2 * np.array(pulse.force_n) @ reach
        return total

    start = np.array(clip.state), np.array(clip.velocity)
    states, velocities = release(mechanism, *start, time_s=time_s, push=push, rtol=config.rtol)
    return states, velocities, np.array([push(t, q) for t, q in zip(time_s, states, strict=True)])


def compute_jacobian(
    mechanism: Mechanism, q: Vector, body: int, at_m: Float64[np.ndarray, "2"]
) -> Float64[np.ndarray, "2 d"]:
    """Derivative of a body's point ``at_m`` [m], in the body's coordinates, with respect to ``q``."""

    def place(states: Series) -> Float64[np.ndarray, "T 2"]:
        x, y, angle = mechanism.poses(states)[:, body].T
        offset = (at_m[0] + 1j * at_m[1]) * np.exp(1j * angle)
        return np.stack([x + offset.real, y + offset.imag], axis=1)

    return np.ascontiguousarray(differentiate(place, q).T)
