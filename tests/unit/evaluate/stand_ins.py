"""A world whose answers are known: a two-mode damped oscillator, drawn linearly into small images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from omegaconf import OmegaConf
from scipy.linalg import expm

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.protocol import EvaluationSeries, EvaluationSubject

DT_S = 1001 / 60000
DEFAULTS = Path(__file__).parents[3] / "conf" / "evaluate" / "default.yaml"
METRIC = np.diag([0.1, 1.9])
FREQUENCIES_HZ, RATES_PER_S = np.array([2.3, 1.4]), np.array([0.9, 0.4])
HEIGHT, WIDTH = 6, 5


def settings(**changes) -> EvaluateConfig:
    schema = OmegaConf.structured(EvaluateConfig)
    changes = {"starts": 12} | changes
    return OmegaConf.to_object(OmegaConf.merge(schema, OmegaConf.load(DEFAULTS), changes))


def transition(scale: float = 1.0) -> np.ndarray:
    """Exact map of (q, v) over one frame; ``scale`` multiplies the frequencies."""
    omega, rate = 2 * np.pi * FREQUENCIES_HZ * scale, RATES_PER_S
    system = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(omega**2 + rate**2), -2 * np.diag(rate)]])
    return expm(system * DT_S)


def integrate(q0, v0, inputs, steps_s=DT_S, *, scale: float = 1.0):
    """The true law: the input pushes the velocity of both coordinates."""
    step, state = transition(scale), np.concatenate([q0, v0], axis=1)
    states = [state]
    for i in range(inputs.shape[1] - 1):
        pushed = state.copy()
        pushed[:, 2:] += inputs[:, i, :1] * DT_S * 60.0
        state = pushed @ step.T
        states.append(state)
    return np.stack(states, axis=1)[..., :2]


def render(q):
    """Affine images in [0, 1]: the first coordinate paints the top, the second the bottom."""
    images = np.full((len(q), 3, HEIGHT, WIDTH), 0.5, dtype=np.float32)
    images[:, :, : HEIGHT // 2] += 0.02 * q[:, 0, None, None, None].astype(np.float32)
    images[:, :, HEIGHT // 2 :] += 0.08 * q[:, 1, None, None, None].astype(np.float32)
    return images


def world(*, frames: int = 1500, tail: int = 600, noise: float = 0.0, inputs: bool = True, seed: int = 4):
    """A held-out part with a random drive and a free tail, and its pictures."""
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.normal(size=(frames // 20 + 1, 1)), 20, axis=0)[:frames]
    drive[frames - tail :] = 0.0
    q = integrate(np.zeros((1, 2)), np.zeros((1, 2)), drive[None])[0]
    clean = q / q.std()
    # the law is linear: states and drive scale together
    encoded = clean + noise * rng.normal(size=q.shape)
    drive = drive / q.std() if inputs else np.zeros((frames, 0))
    held = EvaluationSeries(
        encoded=encoded,
        latents=encoded,
        forcing=drive,
        inputs=drive,
        segments=((0, frames),),
        metric=METRIC,
        dt_s=DT_S,
        skip=40,
    )
    stored = render(clean)

    def pictures(chosen):
        return stored[chosen]

    return held, pictures


def subject(**changes) -> EvaluationSubject:
    """The true law as a model of the world, with some of its parts changed."""
    held, pictures = world()
    parts = {"held": held, "pictures": pictures, "render": render, "integrate": integrate} | changes
    return EvaluationSubject(d=2, dynamics="linear", external_force="none", **parts)


def cut(held: EvaluationSeries, *edges: int) -> EvaluationSeries:
    """The same series, cut into clips."""
    return replace(held, segments=tuple(zip((0, *edges), (*edges, held.n_frames), strict=True)))
