"""The reconstruction loss: what stage 1 minimises."""

from typing import NamedTuple

from torch import Tensor

from lagsplat.shapes import Images, Latents
from lagsplat.splat.losses import anisotropy, nonlocal_filter, structural_dissimilarity
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.config import LossConfig


class Reconstruction(NamedTuple):
    """The loss to minimise, and the two photometric figures worth watching."""

    loss: Tensor
    l1: Tensor
    mse: Tensor


def reconstruct(
    autoencoder: Autoencoder, images: Images, config: LossConfig, *, latents: Latents | None
) -> Reconstruction:
    """Encode, draw and score a batch; with ``latents`` given, these are drawn instead.

    Source: paper eq. (recon_loss).
    """
    drawn = autoencoder.decode(autoencoder.encode(images) if latents is None else latents)
    error = drawn - images
    l1 = error.abs().mean()
    loss = config.l1 * l1
    if config.ssim:
        loss = loss + config.ssim * structural_dissimilarity(drawn, images, window=config.ssim_window)
    if config.anisotropy:
        loss = loss + config.anisotropy * anisotropy(
            autoencoder.gaussians.covariance(), limit=config.anisotropy_limit
        )
    if config.nonlocal_filter:
        loss = loss + config.nonlocal_filter * nonlocal_filter(autoencoder.encoder.filters())
    return Reconstruction(loss, l1.detach(), error.detach().square().mean())
