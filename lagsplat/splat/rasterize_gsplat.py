"""The CUDA rasteriser: gsplat's kernels, on Gaussians that are already two-dimensional.

gsplat projects three-dimensional Gaussians before it rasterises. Only its second half is used here, so no
camera model adds error: the conics are exact, the batch's images are gsplat's images, and the depth of a
Gaussian is its index, which gsplat sorts as a float32, exact up to 2^24.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int32
from torch import Tensor

from lagsplat.splat.image_model import ALPHA_MIN, BLUR_PX2, require_scene

TILE_PX = 16


class GsplatScene(NamedTuple):
    """Arguments of gsplat's tile intersection and rasterisation."""

    means: Float[Tensor, "B K 2"]
    radii: Int32[Tensor, "B K 2"]
    depths: Float[Tensor, "B K"]
    conics: Float[Tensor, "B K 3"]
    colors: Float[Tensor, "B K 3"]
    opacities: Float[Tensor, "B K"]


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
    """Draw B images of K Gaussians on CUDA in float32, differentiable once in all five tensors.

    Args: as `lagsplat.splat.rasterize_torch.rasterize`.

    Raises:
        ValueError: shapes, types or devices do not match, or the tensors are not float32 on a CUDA device.
        ImportError: gsplat is not installed, or has no compiled kernels.
    """
    require_scene(means, covariance, opacity, color, background, height=height, width=width)
    if means.dtype != torch.float32 or means.device.type != "cuda":
        raise ValueError(
            f"the gsplat rasteriser draws float32 tensors on a CUDA device, got {means.dtype} on "
            f"{means.device}: move them there, or choose the backend 'numba' or 'torch'"
        )
    gsplat = _require_gsplat()
    batch, count = opacity.shape
    if batch == 0 or count == 0:
        return background[None, :, None, None].expand(batch, 3, height, width)
    scene = embed_in_space(means, covariance, opacity, color)
    across, down = -(-width // TILE_PX), -(-height // TILE_PX)
    with torch.no_grad():
        _, keys, order = gsplat.isect_tiles(scene.means, scene.radii, scene.depths, TILE_PX, across, down)
        offsets = gsplat.isect_offset_encode(keys, batch, across, down)
    images, _ = gsplat.rasterize_to_pixels(
        scene.means,
        scene.conics,
        scene.colors,
        scene.opacities,
        width,
        height,
        TILE_PX,
        offsets,
        order,
        backgrounds=background.expand(batch, 3),
    )
    return images.permute(0, 3, 1, 2).contiguous()


def embed_in_space(
    means: Float[Tensor, "B K 2"],
    covariance: Float[Tensor, "*S K 3"],
    opacity: Float[Tensor, "B K"],
    color: Float[Tensor, "*S K 3"],
) -> GsplatScene:
    """The Gaussians as gsplat's projection would return them; one that is not drawn gets radius 0."""
    batch, count = opacity.shape
    xx, xy, yy = covariance.double().unbind(-1)
    xx, yy = xx + BLUR_PX2, yy + BLUR_PX2
    proper = covariance.isfinite().all(-1) & (xx > 0) & (xx * yy - xy**2 > 0)
    # Replaced before the division: autograd would turn an unused infinity into NaN.
    xx, xy, yy = torch.where(proper, xx, 1.0), torch.where(proper, xy, 0.0), torch.where(proper, yy, 1.0)
    determinant = xx * yy - xy**2
    conics = torch.stack([yy / determinant, -xy / determinant, xx / determinant], dim=-1).float()
    drawn = proper & means.isfinite().all(2) & opacity.isfinite() & (opacity >= ALPHA_MIN)
    means, opacity = torch.where(drawn[..., None], means, 0.0), torch.where(drawn, opacity, 0.0)
    reach = (2.0 * (opacity.detach() / ALPHA_MIN).clamp(min=1.0).log()).sqrt()
    extent = torch.stack([xx, yy], dim=-1).sqrt().float().detach()
    radii = (reach[..., None] * extent).clamp(max=2.0**24).ceil().clamp(min=1.0)
    return GsplatScene(
        means=means,
        radii=torch.where(drawn[..., None], radii, 0.0).to(torch.int32),
        depths=torch.arange(count, device=means.device, dtype=torch.float32).expand(batch, count),
        conics=conics.expand(batch, count, 3),
        colors=color.expand(batch, count, 3),
        opacities=opacity,
    )


def _require_gsplat():  # type: ignore[no-untyped-def]
    """Import gsplat and check that it has its kernels."""
    try:
        import gsplat
        from gsplat.cuda._backend import _C
    except ImportError as error:
        raise ImportError(
            f"the gsplat rasteriser needs the package gsplat ({error}): pip install 'lagsplat[cuda]', "
            "or choose the backend 'torch'"
        ) from error
    if _C is None:
        raise ImportError(
            "gsplat has no compiled kernels: it needs a CUDA toolkit (nvcc) to build them on first use. "
            "Install one, or choose the backend 'torch'"
        )
    return gsplat
