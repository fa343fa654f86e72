"""Where the decoder's Gaussians are and how they move, in whitened latents."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.chart.chart import Chart
from lagsplat.shapes import Latents
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.induced import DecoderGeometry, decoder_geometry


@dataclass(frozen=True)
class Kinematics:
    """The map from a whitened latent to the centre of each Gaussian, affine and hence of constant Jacobian.

    ``center`` [px] is where a Gaussian stands at its own latent centre, ``geometry`` holds its Jacobian and
    its gate; ``height`` and ``width`` [px] are those of the picture. In space a pixel is a length, see
    `lagsplat.views.space`.

    Source: paper, Appendix "Forces and inertia from the learned kinematics".
    """

    geometry: DecoderGeometry
    center: Float[Tensor, "K n"]
    height: int
    width: int

    @property
    def d(self) -> int:
        """Latent dimension."""
        return self.geometry.center.shape[1]

    @property
    def space(self) -> int:
        """Number of spatial dimensions: 2 in the picture, or 3."""
        return self.center.shape[1]

    def places(self, q: Latents) -> Float[Tensor, "B K n"]:
        """Centres [px], x to the right, y down and, in space, z ahead of the film's camera."""
        away = q[:, None] - self.geometry.center
        return self.center + (self.geometry.jacobian @ away[..., None])[..., 0]

    def presence(self, q: Latents) -> Float[Tensor, "B K"]:
        """Opacity of each Gaussian once its gate is counted."""
        away = (self.geometry.precision_factor @ (q[:, None] - self.geometry.center)[..., None])[..., 0]
        return self.geometry.opacity * torch.exp(-0.5 * away.square().sum(-1))


def kinematics_of(autoencoder: Autoencoder, chart: Chart) -> Kinematics:
    """The kinematics of a decoder in the whitened coordinates of a chart (float64)."""
    return Kinematics(
        geometry=decoder_geometry(autoencoder, chart),
        center=autoencoder.gaussians.center.detach().cpu().double(),
        height=autoencoder.height,
        width=autoencoder.width,
    )
