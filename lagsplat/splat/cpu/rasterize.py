"""The CPU rasteriser: Numba kernels, forward and backward, in parallel over the frames of a batch."""

from typing import Any

import numba
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.splat.cpu.backward import backward
from lagsplat.splat.cpu.forward import forward
from lagsplat.splat.cpu.tile import find_spots
from lagsplat.splat.image_model import BLUR_PX2, require_scene


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
    """Draw B images of K Gaussians on the CPU in float32, differentiable once in all five tensors.

    Uses ``numba.get_num_threads()`` threads. The first call on a machine compiles the kernels (seconds);
    later processes load them from the disk cache.

    Args: as `lagsplat.splat.rasterize_torch.rasterize`.

    Raises:
        ValueError: shapes, types or devices do not match, or the tensors are not float32 on the CPU.
    """
    require_scene(means, covariance, opacity, color, background, height=height, width=width)
    if means.dtype != torch.float32 or means.device.type != "cpu":
        raise ValueError(
            f"the numba rasteriser draws float32 tensors on the CPU, got {means.dtype} on {means.device}: "
            "convert them, or choose the backend 'torch' (float64) or 'gsplat' (CUDA)"
        )
    slices, color = (each if each.ndim == 3 else each[None] for each in (slices_of(covariance), color))
    images: Tensor = _Rasterize.apply(means, slices, opacity, color, background, height, width)
    return images


def slices_of(covariance: Float[Tensor, "*S K 3"]) -> Float[Tensor, "*S K 5"]:
    """The slices of the blurred covariances, laid out as in `lagsplat.splat.cpu.tile`.

    NaN where there is nothing to draw; the gradient there is zero.
    """
    xx, xy, yy = covariance.double().unbind(-1)
    xx, yy = xx + BLUR_PX2, yy + BLUR_PX2
    drawn = covariance.isfinite().all(-1) & (xx > 0) & (xx * yy - xy**2 > 0)
    xx, xy, yy = torch.where(drawn, xx, 1.0), torch.where(drawn, xy, 0.0), torch.where(drawn, yy, 1.0)
    slope = xy / yy
    extents = (2 * torch.stack([xx, yy])).sqrt().detach()
    slices = torch.stack([slope, 0.5 / (xx - slope * xy), 0.5 / yy, *extents], dim=-1)
    return torch.where(drawn[..., None], slices, torch.nan).float()


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        slices: Tensor,
        opacity: Tensor,
        color: Tensor,
        background: Tensor,
        height: int,
        width: int,
    ) -> Tensor:
        means, slices, opacity, color, background = (
            tensor.detach().contiguous() for tensor in (means, slices, opacity, color, background)
        )
        cutoff = (opacity * 255.0).log()
        spots = find_spots(means.numpy(), opacity.numpy(), cutoff.numpy(), slices.numpy())
        images, state = forward(spots, slices.numpy(), color.numpy(), background.numpy(), height, width)
        ctx.save_for_backward(slices, color, background)
        ctx.spots, ctx.state = spots, state
        return torch.from_numpy(images)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        slices, color, background = ctx.saved_tensors
        grad = grad.contiguous()
        spot_grad, shared_grad = backward(
            ctx.spots,
            slices.numpy(),
            color.numpy(),
            background.numpy(),
            ctx.state,
            grad.numpy(),
            numba.get_num_threads(),
        )
        spots = torch.from_numpy(spot_grad.sum(0) if len(spot_grad) > 1 else spot_grad[0])
        shared = torch.from_numpy(shared_grad.sum(0) if len(shared_grad) > 1 else shared_grad[0])
        transmittance = torch.from_numpy(ctx.state[:, 0])
        return (
            spots[..., :2],
            torch.nn.functional.pad(shared[..., :3], (0, 2)),
            spots[..., 2],
            shared[..., 3:],
            (grad * transmittance[:, None]).sum(dim=(0, 2, 3)),
            None,
            None,
        )
