"""Where stage 1 starts: Gaussians on the edges of one frame, latents already unfolded."""

import math

import numpy as np
import torch

from lagsplat.shapes import Frames, Series
from lagsplat.splat.gaussians import Gaussians
from lagsplat.stage1.autoencoder import Autoencoder, encode_frames, to_images
from lagsplat.stage1.config import InitConfig, Stage1Config
from lagsplat.stage1.unfold import unfold

SAMPLE = 1024  # frames whose encodings set the latent scale
FLAT_SHARE = 0.2  # probability given to every pixel, edges taking the rest


def initialize(
    frames: Frames, config: Stage1Config, *, seed: int, latents: Series | None = None
) -> Autoencoder:
    """An untrained autoencoder for these training frames, the same for the same seed.

    With ``latents`` of the frames given, its Gaussians spread over these and its encoder serves nothing.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    _, height, width, _ = frames.shape
    autoencoder = Autoencoder(
        d=config.d,
        n_gaussians=config.n_gaussians,
        kernel=config.kernel,
        channels=config.channels,
        height=height,
        width=width,
        background=config.init.background,
        backend=config.backend,
    )
    picked = np.sort(rng.choice(len(frames), min(SAMPLE, len(frames)), replace=False))
    if latents is None:
        sample = np.asarray(frames[picked])
        if config.init.encoder == "unfolded":
            unfold(autoencoder.encoder, to_images(sample))
        latents = encode_frames(autoencoder, sample)
    reference = np.asarray(frames[0]) / 255.0
    place(autoencoder.gaussians, reference, latents, config.init, rng)
    return autoencoder


@torch.no_grad()
def place(
    gaussians: Gaussians,
    reference: np.ndarray,
    latents: np.ndarray,
    config: InitConfig,
    rng: np.random.Generator,
) -> None:
    """Scatter the Gaussians over ``reference`` (H, W, 3), in [0, 1], and over the ``latents`` (T, d)."""
    height, width, _ = reference.shape
    edges = np.abs(np.stack(np.gradient(np.pad(reference.mean(-1), 1, mode="edge")))).sum(0)[1:-1, 1:-1]
    density = (1 - FLAT_SHARE) * edges / max(edges.sum(), 1e-12) + FLAT_SHARE / edges.size
    pixels = rng.choice(edges.size, gaussians.n, p=(density / density.sum()).ravel())
    rows, columns = np.divmod(pixels, width)
    jitter = rng.random((gaussians.n, 2))  # within the pixel, so that no two Gaussians coincide
    spread = np.maximum(latents.std(0), 1e-3)
    sigma = max(float(spread.max()), 0.25) * config.latent_sigma

    gaussians.center.copy_(torch.as_tensor(np.stack((columns, rows), 1) + jitter))
    centers = latents.mean(0) + spread * rng.standard_normal((gaussians.n, gaussians.d))
    gaussians.latent_center.copy_(torch.as_tensor(centers))
    gaussians.precision_log_diagonal.fill_(-math.log(sigma))
    gaussians.shape_log_diagonal.fill_(math.log(config.spatial_sigma * height))
    gaussians.opacity_logit.fill_(math.log(config.opacity / (1 - config.opacity)))
    colors = np.clip(reference[rows, columns], 0.01, 0.99)
    gaussians.color_logit.copy_(torch.as_tensor(colors).logit())
    if gaussians.background_logit is not None:
        gaussians.background_logit.copy_(torch.as_tensor(reference.mean((0, 1)).clip(0.01, 0.99)).logit())
