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


@torch.no_grad()
def spread_latents(encoder: Encoder, images: Images) -> None:
    """Set the linear layer, in place, so that ``images`` get latents of zero mean and unit covariance.

    The latent axes become the leading principal components of the untrained features. Started from its
    default, the encoder sends every frame to nearly the same latent, and training idles for thousands of
    steps until the latent opens. With fewer distinct images than axes the remaining axes start closed.

    Source: data-dependent initialisation, Krähenbühl et al. 2016, arXiv:1511.06856.
    """
    features = encoder.features(images).double()
    mean = features.mean(0)
    _, deviations, axes = torch.linalg.svd(features - mean, full_matrices=False)
    sigma = deviations[: encoder.head.out_features] / max(len(images) - 1, 1) ** 0.5
    open_axes = int((sigma > 1e-6 * sigma[0].clamp_min(1e-30)).sum())
    weight = torch.zeros(encoder.head.out_features, features.shape[1], dtype=torch.float64)
    weight[:open_axes] = axes[:open_axes] / sigma[:open_axes, None]
    encoder.head.weight.copy_(weight)
    encoder.head.bias.copy_(-weight @ mean)


def sensitivity(encoder: Encoder, images: Images) -> float:
    """How far the latents move when every weight moves by one against them: the 1-norm of dz/dweights.

    A mean over images and latent axes. Adam moves every weight by about its rate, so the rate times this
    bounds the first steps of a latent. It differs by a factor of ten between recordings: the smaller the part
    of the image that moves, the more `spread_latents` has to amplify it.
    """
    parameters = list(encoder.parameters())
    norms = [
        sum(float(slope.abs().sum()) for slope in torch.autograd.grad(axis, parameters, retain_graph=True))
        for image in images
        for axis in encoder(image[None])[0]
    ]
    return sum(norms) / len(norms)
