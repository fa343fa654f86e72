"""A key-point forecaster in miniature, on pictures that move in the plainest way."""

from pathlib import Path

import numpy as np
from omegaconf import OmegaConf

from lagsplat.baselines.config import ForecasterConfig

CONF = Path(__file__).parents[4] / "conf" / "forecaster" / "keypoints.yaml"
STEPS = {"warm_up": 10, "free": 40, "keys": 30, "joint": 30, "graph": 60}


def settings(**changes: object) -> ForecasterConfig:
    schema = OmegaConf.structured(ForecasterConfig)
    small = {
        "n_gaussians": 60,
        "steps": STEPS,
        "backend": "torch",
        "motion": {"feature": 4, "hidden": 16, "layers": 2, "key_points": 8, "neighbours": 3},
        "graph": {"history": 6, "hidden": 8, "blocks": 1, "batch": 8},
    }
    values = OmegaConf.load(CONF)
    return OmegaConf.to_object(OmegaConf.merge(schema, values, small, changes))


def frames(count: int = 24, *, moving: bool = True, side: int = 16) -> np.ndarray:
    """A bright square that swings before a grey wall, uint8 (T, H, W, 3)."""
    angle = np.cos(2 * np.pi * np.arange(count) / 8.0) * moving
    x = side * (0.5 + 0.2 * angle)
    rows, columns = np.indices((side, side)) + 0.5
    ink = np.clip(3.0 - np.abs(columns[None] - x[:, None, None]), 0, 1) * (np.abs(rows - side / 2) < side / 4)
    return np.round(255 * (0.3 + 0.6 * ink[..., None] * np.array([1.0, 0.7, 0.2]))).astype(np.uint8)
