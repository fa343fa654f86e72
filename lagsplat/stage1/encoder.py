"""The encoder, and a limit on how far a step of the optimiser may move its latents."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.array_types import Images, Latents

POOLED = 4  # the last feature map is pooled to POOLED x POOLED, whatever the image


class Encoder(nn.Module):
    """Three large convolutions of stride 2 with ELU, a pool to 4x4, one linear layer to the latent.

    No normalisation layer and no output activation: the chart computes its own statistics afterwards. Each
    latent is less a quadratic function ``bend`` of those before it, which is zero until `remove_squares`
    sets it: a linear layer alone cannot unbend what the images bend.

    Source: paper, Implementation Details (architectures).
    """

    bend: Tensor

    def __init__(self, d: int, *, kernel: int, channels: int) -> None:
        super().__init__()
        self.register_buffer("bend", torch.zeros(d, d, d))
        widths = (3, channels, channels, channels)
        self.convolutions = nn.ModuleList(
            nn.Conv2d(n_in, n_out, kernel, stride=2, padding=(kernel - 2) // 2)
            for n_in, n_out in pairwise(widths)
        )
        self.head = nn.Linear(channels * POOLED**2, d)

    def filters(self) -> list[Float[Tensor, "_ _ k k"]]:
        """Weights of the convolutions, from first layer to last."""
        return [convolution.weight for convolution in self.convolutions]  # type: ignore[misc]

    def features(self, images: Images) -> Tensor:
        """Input of the linear layer: (B, channels * 16)."""
        hidden = images
        for convolution in self.convolutions:
            hidden = functional.elu(convolution(hidden))
        return functional.adaptive_avg_pool2d(hidden, POOLED).flatten(1)

    def forward(self, images: Images) -> Latents:
        """The raw latent ``z`` of each image."""
        bent = self.head(self.features(images))
        straight = [torch.ones_like(bent[:, 0])]
        for k in range(bent.shape[1]):
            before = torch.stack(straight, 1)
            quadratic = self.bend[k, : k + 1, : k + 1]
            straight.append(bent[:, k] - torch.einsum("bi,ij,bj->b", before, quadratic, before))
        return torch.stack(straight[1:], 1)


@contextmanager
def limit_latent_step(encoder: Encoder, images: Images, *, limit: float | None) -> Iterator[None]:
    """Shorten an optimiser step that moves the latents of ``images`` by more than ``limit``.

    ``limit`` is the rms move over the rms distance of these latents from their mean; None allows any step.
    Without it, one step in which all weights agree can push every latent away from the Gaussians. Then
    nothing is drawn, no gradient flows, and training stalls.
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
