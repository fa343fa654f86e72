"""A simulated recording of a mechanism that is let go: its motion, its film, and the truth behind both."""

from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.io.checksum import sha256_of_arrays
from lagsplat.io.recording import Recording
from lagsplat.systems.film import film_clips
from lagsplat.systems.linkage import Linkage
from lagsplat.systems.mechanism import (
    STEP,
    Mechanism,
    Push,
    Series,
    Vector,
    equilibrium,
    free_modes,
    let_go,
)
from lagsplat.systems.release_config import PushConfig, ReleaseConfig
from lagsplat.systems.rocker import Rocker
from lagsplat.systems.truth import Truth, truth_of


def mechanism_of(config: ReleaseConfig) -> Mechanism:
    """The mechanism that these values describe."""
    if config.rocker is not None:
        return Rocker(**asdict(config.rocker), gravity=config.gravity)
    assert config.linkage is not None, "the configuration gives one of the two"
    links = {name: np.array(values) for name, values in asdict(config.linkage).items()}
    return Linkage(**links, gravity=config.gravity)


def release(config: ReleaseConfig, *, seed: int) -> tuple[Recording, Truth]:
    """Let the mechanism go once a clip, film it, and read the film back.

    One seed gives one recording, bit for bit on one machine with one build of OpenCV. The camera draws from a
    stream of its own, and the motion from none: pictures of another size show the same motion.

    Raises:
        ValueError: the mechanism has no rest state, or OpenCV cannot write the codec.
        RuntimeError: the motion cannot be integrated.
    """
    mechanism = mechanism_of(config)
    motions = [_move(mechanism, config, i) for i in range(len(config.clips))]
    states, velocities, forces = (np.concatenate(part) for part in zip(*motions, strict=True))
    film = film_clips(config, [mechanism.poses(clip[0]) for clip in motions], seed=seed)
    looks = " and ".join(body.shape for body in config.bodies)
    recording = replace(
        film,
        meta={
            "origin": "simulated",
            "source": f"lagsplat.systems.release, {looks}, seed {seed}",
            "sha256": sha256_of_arrays(film.frames),
            "licence": "BSD-3-Clause",
            "simulation": asdict(config),
            "seed": seed,
            "footage": film.meta["footage"],
        },
    )
    truth = truth_of(
        mechanism,
        states,
        velocities,
        pressures=film.inputs,
        forces=forces,
        rest=equilibrium(mechanism),
        modes=free_modes(mechanism),
    )
    return recording, truth


def _move(mechanism: Mechanism, config: ReleaseConfig, index: int) -> tuple[Series, Series, Series]:
    """States, velocities and generalised forces from outside at the frames of one clip."""
    clip = config.clips[index]
    time_s = np.arange(clip.n_frames) * config.dt_s
    push = _pulses(mechanism, [push for push in config.pushes if push.clip == index])
    states, velocities = let_go(
        mechanism, np.array(clip.state), np.array(clip.velocity), time_s=time_s, push=push, rtol=config.rtol
    )
    return states, velocities, np.array([push(t, q) for t, q in zip(time_s, states, strict=True)])


def _pulses(mechanism: Mechanism, pushes: list[PushConfig]) -> Push:
    def force(time_s: float, q: Vector) -> Vector:
        total = np.zeros(len(q))
        for push in pushes:
            share = (time_s - push.start_s) / (push.stop_s - push.start_s)
            if 0 < share < 1:
                reach = jacobian(mechanism, q, push.body, np.array(push.at_m))
                total += np.sin(np.pi * share) ** 2 * np.array(push.force_n) @ reach
        return total

    return force


def jacobian(
    mechanism: Mechanism, q: Vector, body: int, at_m: Float64[np.ndarray, "2"]
) -> Float64[np.ndarray, "2 d"]:
    """How a body's point ``at_m``, in the body's coordinates [m], moves with the coordinates of ``q``."""
    nearby = q + STEP * np.concatenate([np.eye(len(q)), -np.eye(len(q))])
    x, y, angle = mechanism.poses(nearby)[:, body].T
    offset = (at_m[0] + 1j * at_m[1]) * np.exp(1j * angle)
    ahead, behind = np.split(np.stack([x + offset.real, y + offset.imag]), 2, axis=1)
    return (ahead - behind) / (2 * STEP)
