"""A recording small enough to train on in a second: a bright bar that swings on a dark ground."""

import numpy as np

from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.config import InitConfig, LifecycleConfig, LossConfig, RateConfig, Stage1Config
from lagsplat.stage1.gaussian_initialization import initialize_autoencoder
from lagsplat.stage1.training_data import TrainingFrames


def swinging_bar(n: int, *, height: int = 12, width: int = 16) -> np.ndarray:
    """``n`` frames of a soft vertical bar that moves sinusoidally, (n, height, width, 3) uint8."""
    columns = np.arange(width) + 0.5
    place = width / 2 + width / 4 * np.sin(np.arange(n) / 3)
    bar = np.exp(-0.5 * ((columns - place[:, None]) / 1.5) ** 2)
    color = np.array([0.9, 0.5, 0.2])
    image = 0.1 + 0.8 * bar[:, None, :, None] * color
    return np.round(255 * np.broadcast_to(image, (n, height, width, 3))).astype(np.uint8)


def small_config(**changes: object) -> Stage1Config:
    """A configuration that trains in about a second."""
    values = {
        "d": 1,
        "n_gaussians": 40,
        "kernel": 12,
        "channels": 2,
        "steps": 60,
        "batch": 8,
        "backend": "numba",
        "checkpoint_every_s": 0.0,
        "refinement_steps": 0,
        "loss": LossConfig(
            l1=0.8,
            ssim=0.2,
            nonlocal_filter=1e-4,
            anisotropy=0.01,
            linear_response=5e-5,
            ssim_window=7,
            anisotropy_limit=5.0,
        ),
        "rate": RateConfig(
            encoder=1e-3,
            latent_step=0.1,
            center=5e-2,
            gaussian=2e-2,
            warmup_steps=5,
            final_fraction=0.05,
            gradient_clip=None,
        ),
        "init": InitConfig(
            encoder="unfolded", spatial_sigma=0.1, latent_sigma=1.5, opacity=0.5, background="learned"
        ),
        "lifecycle": LifecycleConfig(every=20, start=0.2, stop=0.8, peak_opacity=0.02, split_share=0.5),
    }
    return Stage1Config(**{**values, **changes})


def small_autoencoder(frames: np.ndarray, **changes: object) -> Autoencoder:
    """An untrained autoencoder for these frames."""
    return initialize_autoencoder(TrainingFrames(frames), small_config(**changes), seed=0)[0]
