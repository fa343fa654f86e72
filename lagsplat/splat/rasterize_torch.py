"""The reference rasteriser in torch: the specification that the fast ones must match."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN, blur


def draw_torch(scene: GaussianSlice, height: int, width: int) -> Float[Tensor, "B 3 H W"]:
    """Draw a scene in its own dtype, one image after the other; as `lagsplat.rasterize`."""
    batch = len(scene.means)
    covariance, color = (part.expand(batch, -1, -1) for part in (scene.covariance, scene.color))
    frames = []
    for means, shape, opacity, look in zip(scene.means, covariance, scene.opacity, color, strict=True):
        alpha = evaluate_alphas(means, shape, opacity, height, width)
        after = torch.cumprod(1 - alpha, dim=0)
        # Transmittance never rises, so this keeps the Gaussians in front of the one that finishes the pixel.
        alpha = torch.where(after > TRANSMITTANCE_MIN, alpha, 0)
        after = torch.cumprod(1 - alpha, dim=0)
        ahead = torch.cat([after.new_ones(1, height, width), after])
        light = torch.einsum("khw,khw,kc->chw", alpha, ahead[:-1], look)
        frames.append(light + ahead[-1] * scene.background[:, None, None])
    return torch.stack(frames) if frames else scene.means.new_zeros(0, 3, height, width)


def evaluate_alphas(
    means: Float[Tensor, "K 2"],
    covariance: Float[Tensor, "K 3"],
    opacity: Float[Tensor, " K"],
    height: int,
    width: int,
) -> Float[Tensor, "K H W"]:
    """Alpha of each Gaussian in each pixel, 0 where it is skipped."""
    xx, xy, yy, proper = blur(covariance)
    drawn = proper & means.isfinite().all(1) & opacity.isfinite()
    determinant = xx * yy - xy**2
    conic = torch.stack([yy / determinant, -xy / determinant, xx / determinant])
    a, b, c = conic.to(means.dtype)[:, :, None, None]
    means = torch.where(drawn[:, None], means, 0)
    opacity = torch.where(drawn, opacity, 0)

    x = torch.arange(width, dtype=means.dtype, device=means.device) + 0.5
    y = torch.arange(height, dtype=means.dtype, device=means.device) + 0.5
    dx = x[None, None, :] - means[:, 0, None, None]
    dy = y[None, :, None] - means[:, 1, None, None]
    sigma = (a * dx**2 + c * dy**2) / 2 + b * dx * dy
    alpha = torch.clamp(opacity[:, None, None] * torch.exp(-sigma), max=ALPHA_MAX)
    return torch.where(alpha >= ALPHA_MIN, alpha, 0)
