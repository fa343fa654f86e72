"""The attention-broadcast decoder (ABCD): each coordinate colours the pixels that its map attends to."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.baselines.pixels import PixelNet, pixel_places
from lagsplat.shapes import Images, Latents

FEATURES = 8  # for each coordinate
CLAMP = 1e-6  # of the uniform numbers behind Gumbel noise
LARGEST_NOISE = 5.0
LEAST_SCALE = 1e-3  # of that noise, at pixels where all logits agree

Maps = Float[Tensor, "B G P"]


class AttentionDecoder(nn.Module):
    """Nodes of ``group`` coordinates each, a softmax map a node, a background with a map of its own.

    A pixel's colour is a function of its place and of what its maps give it: the embedded coordinates of the
    nodes, and a learned vector of the background. ``background`` is the background's logit, a constant that
    no list of weights holds. ``noise`` scales the Gumbel noise of training.
    """

    def __init__(
        self, d: int, *, group: int, height: int, width: int, background: float, noise: float
    ) -> None:
        super().__init__()
        if d % group:
            raise ValueError(f"d={d} coordinates do not make nodes of {group}; choose a multiple")
        self.group, self.n_nodes, self.size = group, d // group, (height, width)
        self.background_logit, self.noise = background, noise
        width_of_node = group * FEATURES
        self.attention = PixelNet(d, (128, 64, 64), self.n_nodes)
        self.embed_weight = nn.Parameter(torch.empty(d, FEATURES))
        self.embed_bias = nn.Parameter(torch.zeros(d, FEATURES))
        self.background = nn.Parameter(torch.randn(height * width, width_of_node))
        self.color = PixelNet(width_of_node, (64, 64, 64), 3)
        self.places: Tensor
        self.register_buffer("places", pixel_places(height, width), persistent=False)
        bound = (6 / (1 + FEATURES)) ** 0.5  # Xavier's, of one linear map 1 -> FEATURES a coordinate
        nn.init.uniform_(self.embed_weight, -bound, bound)

    def logits(self, z: Latents) -> Float[Tensor, "B P nodes"]:
        """What each pixel would attend to, the background last."""
        nodes = self.attention(z[:, None], self.places)
        return torch.cat([nodes, torch.full_like(nodes[..., :1], self.background_logit)], -1)

    def maps(self, z: Latents) -> Maps:
        """Attention of the nodes, without the background's."""
        return self.logits(z).softmax(-1)[..., :-1].transpose(1, 2)

    def forward(self, z: Latents, *, generator: torch.Generator | None = None) -> Images:
        """Images in [0, 1]; a generator adds the noise of training to the logits."""
        logits = self.logits(z)
        if generator is not None and self.noise:
            logits = logits + self.noise * _gumbel(logits, generator)
        attention = logits.softmax(-1)
        embedded = (z[..., None] * self.embed_weight + self.embed_bias).unflatten(1, (self.n_nodes, -1))
        features = attention[..., :-1] @ embedded.flatten(2) + attention[..., -1:] * self.background
        return self.color(features, self.places).sigmoid().transpose(1, 2).unflatten(2, self.size)


def _gumbel(logits: Tensor, generator: torch.Generator) -> Tensor:
    """Standard Gumbel noise times the spread of the logits of each pixel, to which nothing is fed back."""
    uniform = torch.rand(logits.shape, generator=generator).clamp(CLAMP, 1 - CLAMP)
    noise = (-(-uniform.log()).log()).clamp(-LARGEST_NOISE, LARGEST_NOISE)
    return logits.detach().std(-1, keepdim=True).clamp_min(LEAST_SCALE) * noise
