"""A film small enough to train on in seconds: a soft square pushed to and fro, after a rest."""

import numpy as np

from lagsplat.baselines.config import BaselineConfig
from lagsplat.baselines.model import BaselineArchitecture
from lagsplat.config.compose import compose
from lagsplat.io.recording.recording import Recording

DT_S = 1 / 60


def pushed_square(frames: int = 160, *, side: int = 16, rest: int = 16, n_train: int = 120) -> Recording:
    push = 0.5 + 0.5 * np.sin(np.arange(frames) / 6.0)
    push[:rest] = 0.0
    place = np.zeros(frames)
    speed = 0.0
    for i in range(1, frames):
        speed += DT_S * (100.0 * (push[i - 1] - place[i - 1]) - 4.0 * speed)
        place[i] = place[i - 1] + DT_S * speed
    grid = np.arange(side) + 0.5
    column = np.exp(-0.5 * ((grid - side * (0.35 + 0.3 * place[:, None])) / 2.0) ** 2)
    row = np.exp(-0.5 * ((grid - side / 2) / 2.0) ** 2)
    image = 0.1 + 0.8 * row[None, :, None, None] * column[:, None, :, None] * np.array([0.9, 0.5, 0.2])
    return Recording(
        frames=np.round(255 * image).astype(np.uint8),
        time_s=DT_S * np.arange(frames),
        inputs=np.stack([push, 1.0 - push], axis=1),
        input_names=("p1", "p2"),
        input_units=("atm", "atm"),
        meta={"origin": "simulated", "source": "pushed square", "sha256": "0", "licence": "none"},
        n_train=n_train,
    )


def settings(name: str, **changes: object) -> BaselineConfig:
    """A choice of ``conf/baseline``, small."""
    small = {"baseline": name, "baseline.d": 4, "baseline.batch": 8, "baseline.rest_frames": 12}
    small |= {"baseline.steps.deconv": 30, "baseline.steps.abcd": 30, "baseline.checkpoint_every_s": 0}
    small |= {f"baseline.{key}": value for key, value in changes.items()}
    return compose("system=toy", "profile=toy", *(f"{key}={value}" for key, value in small.items())).baseline


def architecture(
    decoder: str = "abcd", dynamics: str = "oscillators", **changes: object
) -> BaselineArchitecture:
    values = {"d": 4, "n_inputs": 2, "samples": 4, "height": 16, "width": 24, "dt_s": DT_S}
    values |= {"background": 1.0, "noise": 0.1} | changes
    return BaselineArchitecture(decoder=decoder, dynamics=dynamics, **values)
