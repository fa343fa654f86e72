"""A finer decoder over the frozen chart: the latents stay, the Gaussians are fitted to larger frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from lagsplat.shapes import Frames
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.config import RenderConfig, Stage1Config
from lagsplat.stage1.fit import CurvePoint, fit_autoencoder


def fit_decoder(
    frames: Frames,
    latents: Float64[np.ndarray, "N d"],
    stage1: Stage1Config,
    render: RenderConfig,
    *,
    seed: int,
    checkpoint: Path | None = None,
    identity: str = "",
) -> tuple[Autoencoder, list[CurvePoint]]:
    """Fit Gaussians to ``frames`` at the raw ``latents`` of these frames, which do not change.

    The result draws at the resolution of ``frames``. Its encoder was never trained: encode with the
    autoencoder that the latents are of. Step sizes in pixels grow with the resolution.

    Raises:
        ValueError: frames and latents differ in number.
        FloatingPointError: the loss stops being finite.

    Source: paper, Implementation Details (high-resolution renders retrain the decoder alone).
    """
    if len(frames) != len(latents):
        raise ValueError(
            f"{len(frames)} frames and {len(latents)} latents: each frame needs its own; read the same part "
            "of the same recording at the higher resolution"
        )
    settings = replace(
        stage1,
        n_gaussians=render.n_gaussians,
        steps=render.steps,
        batch=render.batch,
        # the penalty of filters that draw nothing
        loss=replace(stage1.loss, nonlocal_filter=0.0),
        rate=replace(stage1.rate, center=render.factor * stage1.rate.center),
    )
    return fit_autoencoder(
        frames, settings, seed=seed, checkpoint=checkpoint, identity=identity, latents=latents
    )


def finer(height: int, width: int, render: RenderConfig) -> tuple[int, int]:
    """Height and width of the finer frames [pixel]."""
    return round(render.factor * height), round(render.factor * width)
