"""The CPU rasteriser: Numba kernels, forward and backward, in parallel over the frames of a batch."""

from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.splat.cpu.backward import backward
from lagsplat.splat.cpu.forward import forward
from lagsplat.splat.cpu.simd import WIDTH
from lagsplat.splat.cpu.tiles import find_spots
from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import blur


def draw_numba(scene: GaussianSlice, height: int, width: int) -> Float[Tensor, "B 3 H W"]:
    """Draw a float32 scene on the CPU, differentiable once; as `lagsplat.rasterize`."""
    slices, color = slices_of(scene.covariance), scene.color
    if color.ndim == 2:
        slices, color = slices[None], color[None]
    tensors = (scene.means, slices, scene.opacity, color, scene.background)
    images: Tensor = _Rasterize.apply(height, width, *tensors)
    return images


def slices_of(covariance: Float[Tensor, "*S K 3"]) -> Float[Tensor, "*S K 5"]:
    """The slices of the blurred covariances, laid out as in `lagsplat.splat.cpu.tiles`.

    NaN where there is nothing to draw; the gradient there is zero.
    """
    xx, xy, yy, drawn = blur(covariance)
    slope = xy / yy
    extents = (2 * torch.stack([xx, yy])).sqrt().detach()
    slices = torch.stack([slope, 0.5 / (xx - slope * xy), 0.5 / yy, *extents], dim=-1)
    return torch.where(drawn[..., None], slices, torch.nan).float()


class _Spots:
    """The spots of a batch, in memory that goes to a later batch of the same size.

    They are the largest array of a step, and new memory costs as much as several frames, one page at a time.
    """

    _spare: ClassVar[list[np.ndarray]] = []

    def __init__(self, batch: int, count: int) -> None:
        shape = (batch, 6, -(-count // WIDTH) * WIDTH)
        try:
            spare = self._spare.pop()
        except IndexError:  # asked for length first, another thread might take the last
            spare = np.empty(0, np.float32)
        self.array = spare if spare.shape == shape else np.empty(shape, np.float32)

    def __del__(self) -> None:
        if not self._spare:
            self._spare.append(self.array)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, height: int, width: int, *tensors: Tensor) -> Tensor:
        means, slices, opacity, color, background = (part.detach().contiguous() for part in tensors)
        cutoff = (opacity * 255.0).log()
        spots = _Spots(*opacity.shape)
        find_spots(spots.array, means.numpy(), opacity.numpy(), cutoff.numpy(), slices.numpy())
        images, state = forward(spots.array, slices.numpy(), color.numpy(), background.numpy(), height, width)
        ctx.save_for_backward(slices, color, background)
        ctx.spots, ctx.state = spots, state
        return torch.from_numpy(images)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        slices, color, background = ctx.saved_tensors
        grad = grad.contiguous()
        arrays = (ctx.spots.array, slices.numpy(), color.numpy(), background.numpy(), ctx.state, grad.numpy())
        spot_grad, shared_grad = backward(*arrays)
        spots = torch.from_numpy(spot_grad[0] if len(spot_grad) == 1 else spot_grad.sum(0))
        shared = torch.from_numpy(shared_grad[0] if len(shared_grad) == 1 else shared_grad.sum(0))
        transmittance = torch.from_numpy(ctx.state[:, 0])
        slices_grad = torch.nn.functional.pad(shared[..., :3], (0, 2))
        background_grad = (grad * transmittance[:, None]).sum(dim=(0, 2, 3))
        return None, None, spots[..., :2], slices_grad, spots[..., 2], shared[..., 3:], background_grad
