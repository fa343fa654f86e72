"""The continuity-preserving encoder: few, large filters, so that the latent follows motion without steps."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.shapes import Images, Latents

POOLED = 4  # the last feature map is pooled to POOLED x POOLED, whatever the image


class Encoder(nn.Module):
    """Three large convolutions of stride 2 with ELU, a pool to 4x4, one linear layer to the latent.

    There is no normalisation layer and no output activation: the chart reads its own statistics afterwards.

    Source: paper, Implementation Details (architectures).
    """

    def __init__(self, d: int, *, kernel: int, channels: int) -> None:
        super().__init__()
        widths = (3, channels, channels, channels)
        self.convolutions = nn.ModuleList(
            nn.Conv2d(n_in, n_out, kernel, stride=2, padding=(kernel - 2) // 2)
            for n_in, n_out in pairwise(widths)
        )
        self.head = nn.Linear(channels * POOLED**2, d)

    def filters(self) -> list[Float[Tensor, "_ _ k k"]]:
        """Weights of the convolutions, first layer first."""
        return [convolution.weight for convolution in self.convolutions]  # type: ignore[misc]

    def features(self, images: Images) -> Tensor:
        """What the linear layer reads: (B, channels * 16)."""
        hidden = images
        for convolution in self.convolutions:
            hidden = functional.elu(convolution(hidden))
        return functional.adaptive_avg_pool2d(hidden, POOLED).flatten(1)

    def forward(self, images: Images) -> Latents:
        """The raw latent ``z`` of each image."""
        return self.head(self.features(images))


def sensitivity(encoder: Encoder, images: Images) -> float:
    """How far the latents move when every weight moves by one against them: the 1-norm of dz/dweights.

    A mean over images and latent axes. Adam moves every weight by about its rate, so the rate times this
    bounds the first steps of a latent. It differs by a factor of ten between recordings: the smaller the part
    of the image that moves, the more `lagsplat.stage1.unfold.unfold` has to amplify it.
    """
    parameters = list(encoder.parameters())
    norms = [
        sum(float(slope.abs().sum()) for slope in torch.autograd.grad(axis, parameters, retain_graph=True))
        for image in images
        for axis in encoder(image[None])[0]
    ]
    return sum(norms) / len(norms)
