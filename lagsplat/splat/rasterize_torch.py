"""The reference rasteriser in torch: the specification that the fast ones must match."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.splat.image_model import ALPHA_MAX, ALPHA_MIN, BLUR_PX2, TRANSMITTANCE_MIN, require_scene


def rasterize(
    means: Float[Tensor, "B K 2"],
    covariance: Float[Tensor, "*S K 3"],
    opacity: Float[Tensor, "B K"],
    color: Float[Tensor, "*S K 3"],
    background: Float[Tensor, " 3"],
    *,
    height: int,
    width: int,
) -> Float[Tensor, "B 3 H W"]:
    """Draw B images of K Gaussians with torch, in the dtype of the arguments (float64 for checks).

    Differentiates by autograd, and needs memory for about 10 B K H W numbers.

    Args:
        means: Centres [px].
        covariance: xx, xy, yy [px^2], shared by all images or per image (S = B).
        opacity: In [0, 1].
        color: RGB, shared or per image like ``covariance``.
        background: RGB where the transmittance is left.
        height, width: Size of the images [px].

    Raises:
        ValueError: shapes, types or devices do not match.

    Source: the image model in `lagsplat.splat.image_model`.

    Example:
        >>> import lagsplat, torch
        >>> means, opacity = torch.tensor([[[8.0, 4.0]]]), torch.ones(1, 1)
        >>> covariance, color = torch.tensor([[[4.0, 0.0, 4.0]]]), torch.ones(1, 1, 3)
        >>> lagsplat.rasterize(means, covariance, opacity, color, torch.zeros(3), height=8, width=16).shape
        torch.Size([1, 3, 8, 16])
    """
    require_scene(means, covariance, opacity, color, background, height=height, width=width)
    frames = [
        _render(*scene, background, height, width)
        for scene in zip(
            means,
            covariance.expand(len(means), -1, -1),
            opacity,
            color.expand(len(means), -1, -1),
            strict=True,
        )
    ]
    return torch.stack(frames) if frames else means.new_zeros(0, 3, height, width)


def _render(
    means: Float[Tensor, "K 2"],
    covariance: Float[Tensor, "K 3"],
    opacity: Float[Tensor, " K"],
    color: Float[Tensor, "K 3"],
    background: Float[Tensor, " 3"],
    height: int,
    width: int,
) -> Float[Tensor, "3 H W"]:
    alpha = _alpha(means, covariance, opacity, height, width)
    after = torch.cumprod(1 - alpha, dim=0)
    # Transmittance never rises, so this keeps the Gaussians in front of the one that finishes the pixel.
    alpha = torch.where(after > TRANSMITTANCE_MIN, alpha, 0)
    after = torch.cumprod(1 - alpha, dim=0)
    ahead = torch.cat([after.new_ones(1, height, width), after])
    light = torch.einsum("khw,khw,kc->chw", alpha, ahead[:-1], color)
    return light + ahead[-1] * background[:, None, None]


def _alpha(
    means: Float[Tensor, "K 2"],
    covariance: Float[Tensor, "K 3"],
    opacity: Float[Tensor, " K"],
    height: int,
    width: int,
) -> Float[Tensor, "K H W"]:
    """Alpha (K, H, W) of each Gaussian in each pixel, 0 where it is skipped."""
    xx, xy, yy = covariance.double().unbind(1)
    xx, yy = xx + BLUR_PX2, yy + BLUR_PX2
    finite = covariance.isfinite().all(1) & means.isfinite().all(1) & opacity.isfinite()
    drawn = finite & (xx > 0) & (xx * yy - xy**2 > 0)
    # Replaced before the division, not after it: autograd would turn an unused infinity into NaN.
    xx, xy, yy = torch.where(drawn, xx, 1.0), torch.where(drawn, xy, 0.0), torch.where(drawn, yy, 1.0)
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
