"""The reconstruction loss that stage 1 minimises, and its optimiser with step size schedule."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Images, Latents
from lagsplat.splat.losses import anisotropy, nonlocal_filter, structural_dissimilarity
from lagsplat.splat.projection import View
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.config import LossConfig, RateConfig


class ReconstructionLoss(NamedTuple):
    """The loss to minimise, and two photometric errors to monitor."""

    loss: Tensor
    l1: Tensor
    mse: Tensor


class NovelViewTargets(NamedTuple):
    """The same instants, each from one other camera, and the weight of the error there."""

    images: Images
    cover: Float[Tensor, "B 1 H W"] | None  # in [0, 1], known share of a pixel; None if all is known
    view: View
    weight: float


def reconstruct(
    autoencoder: Autoencoder,
    images: Images,
    config: LossConfig,
    *,
    latents: Latents | None,
    sides: NovelViewTargets | None = None,
) -> ReconstructionLoss:
    """Encode, draw and score a batch.

    Args:
        autoencoder: The model.
        images: Recorded images.
        config: Weights of the terms.
        latents: Raw latents to draw instead of encoded ones.
        sides: Novel views at the same latents, which add photometric terms.

    Source: paper eq. (recon_loss) and "Supervision".
    """
    z = autoencoder.encode(images) if latents is None else latents
    if sides is None:
        drawn = autoencoder.decode(z)
        loss = photometric_loss(drawn, images, config)
    else:
        own = autoencoder.filmed_view(z)
        view = View(
            *(torch.cat([a.expand(len(z), *a.shape[1:]), b]) for a, b in zip(own, sides.view, strict=True))
        )
        drawn, aside = autoencoder.decode(z.repeat(2, 1), view=view).chunk(2)
        loss = photometric_loss(drawn, images, config)
        loss = loss + sides.weight * photometric_loss(aside, _filled(sides, aside), config)
    if config.anisotropy:
        loss = loss + config.anisotropy * anisotropy(
            autoencoder.gaussians.covariance(), limit=config.anisotropy_limit
        )
    if config.nonlocal_filter:
        loss = loss + config.nonlocal_filter * nonlocal_filter(autoencoder.encoder.filters())
    error = (drawn - images).detach()
    return ReconstructionLoss(loss, error.abs().mean(), error.square().mean())


def photometric_loss(drawn: Images, images: Images, config: LossConfig) -> Tensor:
    """Weighted sum of absolute error and structural dissimilarity."""
    loss = config.l1 * (drawn - images).abs().mean()
    if config.ssim:
        loss = loss + config.ssim * structural_dissimilarity(drawn, images, window=config.ssim_window)
    return loss


def _filled(sides: NovelViewTargets, drawn: Images) -> Images:
    """Targets of novel views; where they are unknown the drawn image itself, so the error is zero."""
    if sides.cover is None:
        return sides.images
    return torch.lerp(drawn.detach(), sides.images, sides.cover)


def make_optimizer(autoencoder: Autoencoder, config: RateConfig) -> torch.optim.Adam:
    """Adam with three groups: encoder, parameters in pixels, other parameters of the Gaussians."""
    in_pixels = ("center", "coupling")
    gaussians = dict(autoencoder.gaussians.named_parameters())
    groups = [
        {"params": list(autoencoder.encoder.parameters()), "peak": config.encoder},
        {"params": [gaussians[name] for name in in_pixels], "peak": config.center},
        {
            "params": [value for name, value in gaussians.items() if name not in in_pixels],
            "peak": config.gaussian,
        },
    ]
    return torch.optim.Adam(groups, fused=True)


def set_rates(optimizer: torch.optim.Optimizer, config: RateConfig, *, step: int, steps: int) -> None:
    """Set each group's rate: linear warm-up, then a half cosine from the peak to its final fraction."""
    for group in optimizer.param_groups:
        group["lr"] = group["peak"] * rate_factor(config, step=step, steps=steps)


def rate_factor(config: RateConfig, *, step: int, steps: int) -> float:
    """The share of the peak rate at a step, the same for all groups."""
    warmup = min(1.0, (step + 1) / max(config.warmup_steps, 1))
    cosine = 0.5 * (1 + math.cos(math.pi * step / steps))
    return warmup * (config.final_fraction + (1 - config.final_fraction) * cosine)
