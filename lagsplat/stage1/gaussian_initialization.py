"""The untrained autoencoder of stage 1: Gaussians on the edges of one frame, spread over the latents."""

import math

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.splat.gaussians import Gaussians
from lagsplat.splat.projection import make_view
from lagsplat.stage1.autoencoder import Autoencoder, encode_frames
from lagsplat.stage1.config import InitConfig, Stage1Config
from lagsplat.stage1.encoder_initialization import SAMPLE, initialize_encoder
from lagsplat.stage1.linear_response import LinearResponse
from lagsplat.stage1.training_data import TrainingFrames
from lagsplat.views.novel import NovelViews

FLAT_SHARE = 0.2  # probability spread over all pixels; those of interest share the rest


def initialize_autoencoder(
    footage: TrainingFrames, config: Stage1Config, *, seed: int
) -> tuple[Autoencoder, LinearResponse | None]:
    """Build an untrained autoencoder for these frames, deterministic in the seed.

    If inputs drive the motion, its latents are their linear response, which is returned as well.

    If the frames have given latents, the Gaussians spread over these and the encoder is unused. With novel
    views the Gaussians live in space.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    height, width = footage.stored.shape[1:3]
    film = None if footage.novel is None else footage.novel.space.reference
    autoencoder = Autoencoder(
        d=config.d,
        n_gaussians=config.n_gaussians,
        kernel=config.kernel,
        channels=config.channels,
        height=height,
        width=width,
        background=config.init.background,
        lens=None if film is None else [*film.focal, *film.middle],
        backend=config.backend,
    )
    picked = np.sort(rng.choice(len(footage), min(SAMPLE, len(footage)), replace=False))
    response = None
    if footage.latents is None and config.init.encoder == "unfolded":
        response = initialize_encoder(autoencoder.encoder, footage, seed=seed)
    stored, known = footage.stored.cpu().numpy(), footage.latents
    latents = encode_frames(autoencoder, stored[picked]) if known is None else known.double().cpu().numpy()
    place_gaussians(autoencoder.gaussians, stored[0] / 255.0, latents, config.init, rng)
    if footage.novel is not None and footage.supervision is not None:
        lift_to_depth(autoencoder.gaussians, footage, footage.novel, footage.supervision.spread, rng)
    return autoencoder, response


@torch.no_grad()
def lift_to_depth(
    gaussians: Gaussians, footage: TrainingFrames, novel: NovelViews, spread: float, rng: np.random.Generator
) -> None:
    """Scatter Gaussians of space, in place, over the images of the first instant from all cameras.

    Each lies on the ray of a pixel of one camera, within a share ``spread`` of the pivot's depth there, and
    has the pixel's colour; its size grows with its depth.
    """
    space = novel.space
    pictures = [footage.stored[0].cpu().numpy(), *(novel.images[0, i] for i in novel.seen)]
    cameras = [space.seen_by(space.reference), *(footage.cameras[i] for i in novel.seen)]
    pivot = space.inside(space.pivot[None])
    parts = np.array_split(rng.permutation(gaussians.n), len(pictures))
    for part, picture, camera in zip(parts, pictures, cameras, strict=True):
        picture = picture / 255.0
        pixels, colors = scatter_points(picture, measure_edges(picture), len(part), rng)
        middle = float(camera.within(pivot)[0, 2])
        depth = middle * (1 + spread * rng.uniform(-1, 1, len(part)))
        view = make_view([camera] * len(part))
        rows = torch.as_tensor(part)
        at = [torch.as_tensor(values, dtype=torch.float32) for values in (pixels, depth)]
        gaussians.center[rows] = view.unproject(*at)
        gaussians.color_logit[rows] = colors.float()
        gaussians.shape_log_diagonal[rows] += (at[1] / camera.focal[0]).log()[:, None]


@torch.no_grad()
def place_gaussians(
    gaussians: Gaussians,
    reference: np.ndarray,
    latents: np.ndarray,
    config: InitConfig,
    rng: np.random.Generator,
) -> None:
    """Scatter the Gaussians over an image and over the latents, in place."""
    pixels, colors = scatter_points(reference, measure_edges(reference), gaussians.n, rng)
    spread = np.maximum(latents.std(0), 1e-3)
    sigma = max(float(spread.max()), 0.25) * config.latent_sigma

    gaussians.center[:, :2] = torch.as_tensor(pixels, dtype=torch.float32)
    centers = latents.mean(0) + spread * rng.standard_normal((gaussians.n, gaussians.d))
    gaussians.latent_center.copy_(torch.as_tensor(centers))
    gaussians.precision_log_diagonal.fill_(-math.log(sigma))
    gaussians.shape_log_diagonal.fill_(math.log(config.spatial_sigma * len(reference)))
    gaussians.opacity_logit.fill_(math.log(config.opacity / (1 - config.opacity)))
    gaussians.color_logit.copy_(colors)
    if gaussians.background_logit is not None:
        gaussians.background_logit.copy_(torch.as_tensor(reference.mean((0, 1)).clip(0.01, 0.99)).logit())


def measure_edges(picture: np.ndarray) -> np.ndarray:
    """Strength of the edges of an image (H, W, 3) at each pixel."""
    return np.abs(np.stack(np.gradient(np.pad(picture.mean(-1), 1, mode="edge")))).sum(0)[1:-1, 1:-1]


def scatter_points(
    picture: np.ndarray, interest: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "N 2"], Float[Tensor, "N 3"]]:
    """Points [px] of an image (H, W, 3), mostly where ``interest`` is large, and logits of their colours."""
    density = (1 - FLAT_SHARE) * interest / max(interest.sum(), 1e-12) + FLAT_SHARE / interest.size
    pixels = rng.choice(interest.size, count, p=(density / density.sum()).ravel())
    rows, columns = np.divmod(pixels, picture.shape[1])
    jitter = rng.random((count, 2))  # within the pixel, so that no two Gaussians coincide
    colors = np.clip(picture[rows, columns], 0.01, 0.99)
    return np.stack((columns, rows), 1) + jitter, torch.as_tensor(colors).logit()
