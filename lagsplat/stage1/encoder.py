"""The continuity-preserving encoder: few, large filters, so that the latent follows motion without steps."""

from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def small_moves(encoder: Encoder, images: Images, *, limit: float | None) -> Iterator[None]:
    """Shorten a step of the optimiser that moves the latents of ``images`` by more than ``limit``.

    ``limit`` is the rms move over the rms distance of these latents from their mean; None allows any step.
    Without it, one step that agrees in all weights can throw every latent out of the cloud of Gaussians. Then
    nothing is drawn, no gradient comes back, and training is over.
    """
    if limit is None:
        yield
        return
    with torch.no_grad():
        start = [parameter.clone() for parameter in encoder.parameters()]
        before = encoder(images)
        yield
        move = (encoder(images) - before).square().mean().sqrt()
        allowed = limit * (before - before.mean(0)).square().mean().sqrt()
        if move > allowed:
            for parameter, origin in zip(encoder.parameters(), start, strict=True):
                parameter.lerp_(origin, float(1 - allowed / move))
