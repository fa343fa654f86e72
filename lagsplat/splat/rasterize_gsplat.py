"""The CUDA rasteriser: gsplat's kernels, on Gaussians that are already two-dimensional.

gsplat projects three-dimensional Gaussians before it rasterises. Only its second half is used here, so no
camera model adds error: the conics are exact, the batch's images are gsplat's images, and the depth of a
Gaussian is its index, which gsplat sorts as a float32, exact up to 2^24.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int32
from torch import Tensor

from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import ALPHA_MIN, blur

TILE_PX = 16


class GsplatScene(NamedTuple):
    """Arguments of gsplat's tile intersection and rasterisation."""

    means: Float[Tensor, "B K 2"]
    radii: Int32[Tensor, "B K 2"]
    depths: Float[Tensor, "B K"]
    conics: Float[Tensor, "B K 3"]
    colors: Float[Tensor, "B K 3"]
    opacities: Float[Tensor, "B K"]


def draw_gsplat(scene: GaussianSlice, height: int, width: int) -> Float[Tensor, "B 3 H W"]:
    """Draw a float32 scene on CUDA, differentiable once; as `lagsplat.rasterize`."""
    gsplat = _require_gsplat()
    batch, count = scene.opacity.shape
    if batch == 0 or count == 0:
        return scene.background[None, :, None, None].expand(batch, 3, height, width)
    splats = embed_in_space(scene)
    across, down = -(-width // TILE_PX), -(-height // TILE_PX)
    with torch.no_grad():
        _, keys, order = gsplat.isect_tiles(splats.means, splats.radii, splats.depths, TILE_PX, across, down)
        offsets = gsplat.isect_offset_encode(keys, batch, across, down)
    look = (splats.means, splats.conics, splats.colors, splats.opacities)
    behind = scene.background.expand(batch, 3)
    images, _ = gsplat.rasterize_to_pixels(*look, width, height, TILE_PX, offsets, order, backgrounds=behind)
    return images.permute(0, 3, 1, 2).contiguous()


def embed_in_space(scene: GaussianSlice) -> GsplatScene:
    """The Gaussians as gsplat's projection would return them; one that is not drawn gets radius 0."""
    means, covariance, opacity, color, _ = scene
    batch, count = opacity.shape
    xx, xy, yy, proper = blur(covariance)
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
        install = "pip install 'lagsplat[cuda]', or choose the backend 'torch'"
        raise ImportError(f"the gsplat rasteriser needs the package gsplat ({error}): {install}") from error
    if _C is None:
        raise ImportError(
            "gsplat has no compiled kernels: install a CUDA toolkit (nvcc), which builds them on first use, "
            "or choose the backend 'torch'"
        )
    return gsplat
