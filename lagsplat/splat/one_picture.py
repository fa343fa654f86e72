"""A cloud of Gaussians prepared for drawing one picture after another, as an interactive loop asks for them.

What does not depend on the latent is worked out once; between two pictures one pass over the Gaussians finds
those that are present and in the picture, and the rasteriser draws them.
`lagsplat.splat.gaussians` and `lagsplat.splat.raster_numba` stay the specification;
`tests/oracle/test_one_picture.py` holds them together.
"""

import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8
from torch import Tensor

from lagsplat.splat.gaussians import Gaussians
from lagsplat.splat.kernel_forward import forward
from lagsplat.splat.kernel_slice import slice_at, to_bytes
from lagsplat.splat.kernel_tile import EXTENT_X, EXTENT_Y
from lagsplat.splat.lanes import WIDTH
from lagsplat.splat.raster_numba import slices_of


class OnePicture:
    """The Gaussians of a decoder, drawn at ``height`` x ``width`` px on the CPU.

    ``stretch`` is how many of these pixels make one of the training resolution, along x and y.
    """

    @torch.no_grad()
    def __init__(
        self, gaussians: Gaussians, *, height: int, width: int, stretch: tuple[float, float]
    ) -> None:
        self.height, self.width = height, width
        x, y = stretch
        covariance = gaussians.covariance().cpu() * torch.tensor([x * x, x * y, y * y])
        slices = slices_of(covariance)
        self.table = _table(gaussians, slices[:, [EXTENT_X, EXTENT_Y]], torch.tensor([x, y]))
        self.slices = slices.numpy()
        self.color = torch.sigmoid(gaussians.color_logit.cpu()).numpy()
        self.background = gaussians.background().cpu().numpy().copy()

    def draw(self, z: Float64[np.ndarray, " d"]) -> UInt8[np.ndarray, "H W 3"]:
        """The picture at the raw latent ``z``; one that is not finite shows the background alone."""
        scene = slice_at(z.astype(np.float32), self.table, self.slices, self.color, self.height, self.width)
        images, _ = forward(*scene, self.background, self.height, self.width)
        return to_bytes(images[0])


def _table(
    gaussians: Gaussians, extents: Float32[Tensor, "K 2"], scale: Float32[Tensor, "2"]
) -> Float32[np.ndarray, "rows K8"]:
    """What `lagsplat.splat.kernel_slice` asks for; who is added to fill it up is never drawn."""
    factor, jacobian = gaussians.precision_factor().cpu(), gaussians.jacobian().cpu()
    center, latent = gaussians.center.cpu(), gaussians.latent_center.cpu()[..., None]
    opacity = torch.sigmoid(gaussians.opacity_logit.cpu())
    row, column = torch.tril_indices(gaussians.d, gaussians.d)
    parts = [
        (center - (jacobian @ latent)[..., 0]) * scale,
        (jacobian * scale[:, None]).flatten(1),
        (factor @ latent)[..., 0],
        factor[:, row, column],
        (255.0 * opacity).log()[:, None],
        opacity[:, None],
        extents,
    ]
    table = torch.cat(parts, 1).T.numpy()
    return np.pad(table, ((0, 0), (0, -table.shape[1] % WIDTH)), constant_values=np.nan).copy()
