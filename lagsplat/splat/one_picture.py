"""A cloud of Gaussians prepared for drawing one picture after another, as an interactive loop asks for them.

What does not depend on the latent is worked out once: between two pictures remain two small products, one
exponential a Gaussian, and the rasteriser. `lagsplat.splat.gaussians` and `lagsplat.splat.raster_numba`
stay the specification; `tests/oracle/test_one_picture.py` holds them together.
"""

import numpy as np
import torch
from jaxtyping import Float64, UInt8

from lagsplat.splat.gaussians import Gaussians
from lagsplat.splat.kernel_forward import forward
from lagsplat.splat.kernel_tile import find_spots
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
        factor, jacobian = gaussians.precision_factor().cpu(), gaussians.jacobian().cpu()
        center, latent = gaussians.center.cpu(), gaussians.latent_center.cpu()[..., None]
        scale = torch.tensor([x, y])
        self.jacobian = (jacobian * scale[:, None]).flatten(0, 1).numpy().copy()
        self.origin = ((center - (jacobian @ latent)[..., 0]) * scale).flatten().numpy().copy()
        self.factor = factor.flatten(0, 1).numpy().copy()
        self.offset = (factor @ latent).flatten().numpy().copy()
        self.opacity = torch.sigmoid(gaussians.opacity_logit.cpu()).numpy().copy()
        self.color = torch.sigmoid(gaussians.color_logit.cpu())[None].numpy().copy()
        self.background = gaussians.background().cpu().numpy().copy()
        covariance = gaussians.covariance().cpu() * torch.tensor([x * x, x * y, y * y])
        self.slices = slices_of(covariance)[None].numpy()

    def draw(self, z: Float64[np.ndarray, " d"]) -> UInt8[np.ndarray, "H W 3"]:
        """The picture at the raw latent ``z``; one that is not finite shows the background alone."""
        z32 = z.astype(np.float32)
        means = (self.jacobian @ z32 + self.origin).reshape(1, -1, 2)
        away = (self.factor @ z32 - self.offset).reshape(-1, len(z32))
        with np.errstate(all="ignore"):  # a Gaussian that has faded to zero has the logarithm of zero
            opacity = (self.opacity * np.exp(-0.5 * np.square(away).sum(1)))[None]
            spots = find_spots(means, opacity, np.log(np.float32(255.0) * opacity), self.slices)
        images, _ = forward(spots, self.slices, self.color, self.background, self.height, self.width)
        return (images[0].clip(0.0, 1.0) * 255.0 + 0.5).astype(np.uint8).transpose(1, 2, 0)
