"""The reconstruction loss that stage 1 minimises, and its optimiser with step size schedule."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.array_types import Images, Latents
from lagsplat.splat.losses import anisotropy, nonlocal_filter, structural_dissimilarity
from lagsplat.splat.projection import View
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.config import LossConfig, RateConfig
from lagsplat.stage1.training import decay_by_cosine


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


class ExpectedLatents(NamedTuple):
    """Latents by the linear response to the inputs, and the variance that it leaves of each coordinate."""

    mean: Latents
    variance: Float[Tensor, " d"]


def reconstruct(
    autoencoder: Autoencoder,
    images: Images,
    config: LossConfig,
    *,
    latents: Latents | None,
    sides: NovelViewTargets | None = None,
    expected: ExpectedLatents | None = None,
) -> ReconstructionLoss:
    """Encode, draw and score recorded images.

    Raw ``latents`` are drawn instead of encoded ones; novel views ``sides`` of them add photometric terms.
    Images leave open how latents are bent: latents near ``expected`` ones are straight.

    Source: paper eq. (recon_loss) and "Supervision".
    """
    z = autoencoder.encode(images) if latents is None else latents
    if sides is None:
        drawn = autoencoder.decode(z)
        loss = photometric_loss(drawn, images, config)
    else:
        film = [part.expand(len(z), *part.shape[1:]) for part in autoencoder.filmed_view(z)]
        view = View(*(torch.cat(parts) for parts in zip(film, sides.view, strict=True)))
        drawn, aside = autoencoder.decode(z.repeat(2, 1), view=view).chunk(2)
        loss = photometric_loss(drawn, images, config)
        target = sides.images
        if sides.cover is not None:  # where the target is unknown, the drawn image itself: no error
            target = torch.lerp(aside.detach(), target, sides.cover)
        loss = loss + sides.weight * photometric_loss(aside, target, config)
    if config.anisotropy:
        covariance = autoencoder.gaussians.covariance()
        loss = loss + config.anisotropy * anisotropy(covariance, limit=config.anisotropy_limit)
    if config.nonlocal_filter:
        loss = loss + config.nonlocal_filter * nonlocal_filter(autoencoder.encoder.filters())
    if expected is not None:
        departure = (z - expected.mean).square() / expected.variance
        loss = loss + config.linear_response * departure.mean()
    error = (drawn - images).detach()
    return ReconstructionLoss(loss, error.abs().mean(), error.square().mean())


def photometric_loss(drawn: Images, images: Images, config: LossConfig) -> Tensor:
    """Weighted sum of absolute error and structural dissimilarity."""
    loss = config.l1 * (drawn - images).abs().mean()
    if config.ssim:
        loss = loss + config.ssim * structural_dissimilarity(drawn, images, window=config.ssim_window)
    return loss


def make_optimizer(autoencoder: Autoencoder, config: RateConfig) -> torch.optim.Adam:
    """Adam with three groups: encoder, parameters in pixels, other parameters of the Gaussians."""
    network, gaussians = autoencoder.encoder.parameters(), dict(autoencoder.gaussians.named_parameters())
    return torch.optim.Adam(group_parameters(network, gaussians, config), fused=True)


def group_parameters(
    network: Iterable[nn.Parameter], gaussians: Mapping[str, nn.Parameter], config: RateConfig
) -> list[dict[str, Any]]:
    """Groups of an optimiser with their peak rates: a network, centres in pixels, the rest of Gaussians."""
    in_pixels = [value for name, value in gaussians.items() if name in ("center", "coupling")]
    others = [value for name, value in gaussians.items() if name not in ("center", "coupling")]
    peaks = (config.encoder, config.center, config.gaussian)
    return [
        {"params": params, "peak": peak}
        for params, peak in zip((list(network), in_pixels, others), peaks, strict=True)
    ]


def set_rates(optimizer: torch.optim.Optimizer, config: RateConfig, *, step: int, steps: int) -> None:
    """Set each group's rate: linear warm-up, then a half cosine from the peak to its final fraction."""
    warmup = min(1.0, (step + 1) / max(config.warmup_steps, 1))
    factor = warmup * decay_by_cosine(step, steps, final=config.final_fraction)
    for group in optimizer.param_groups:
        group["lr"] = group["peak"] * factor
