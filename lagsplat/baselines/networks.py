"""Networks of the baselines: a shared variational encoder, a deconvolutional and an attention decoder.

The attention-broadcast decoder (ABCD) colours the pixels that the map of each node attends to; its centres,
their velocities and the loss terms on the maps are here too. Pixels are listed row by row, P = H W of them,
and are the last axis but one. Their coordinates are ``(y, x)``, each from -1 to 1 between the centres of the
outermost pixels, unlike in the rest of the package.
"""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.array_types import Images, Latents

SLOPE = 0.2  # of LeakyReLU in the encoder and in both decoders
WIDTHS = (3, 32, 64, 128)
REDUCTION = 8  # three halvings of each side
FEATURES = 8  # of the attention decoder, for each coordinate

Places = Float[Tensor, "P 2"]
Points = Float[Tensor, "B G 2"]
Maps = Float[Tensor, "B G P"]


class VariationalEncoder(nn.Module):
    """Three convolutions of kernel 4 and stride 2, and one linear map to a mean and a log-variance.

    ``z`` is the mean, except in the reconstruction of single frames, where it is sampled.
    """

    def __init__(self, d: int, *, height: int, width: int) -> None:
        super().__init__()
        if min(height, width) < REDUCTION or height % REDUCTION or width % REDUCTION:
            raise ValueError(
                f"frames of {height} x {width} pixels: the baselines halve each side three times, so both "
                f"must be multiples of {REDUCTION}; set recording.height and recording.width"
            )
        self.d = d
        self.convolutions = nn.ModuleList(
            nn.Conv2d(n_in, n_out, 4, stride=2, padding=1) for n_in, n_out in pairwise(WIDTHS)
        )
        cells = (height // REDUCTION) * (width // REDUCTION)
        self.head = nn.Linear(WIDTHS[-1] * cells, 2 * d)

    def forward(self, images: Images) -> tuple[Latents, Latents]:
        """Mean and log-variance of each image."""
        hidden: Tensor = images
        for convolution in self.convolutions:
            hidden = functional.leaky_relu(convolution(hidden), SLOPE)
        both = self.head(hidden.flatten(1))
        return both[:, : self.d], both[:, self.d :]

    def moving(self, images: Images, rates: Float[Tensor, "B 3 H W"]) -> tuple[Latents, Latents, Latents]:
        """Mean, log-variance, and the velocity [1/s] of the mean while the image changes by ``rates`` [1/s].

        The velocity is the Jacobian of the mean times ``rates``, exact, in one forward pass.
        """
        (mean, log_variance), (velocity, _) = torch.func.jvp(self.forward, (images,), (rates,))[:2]
        return mean, log_variance, velocity


class DeconvDecoder(nn.Module):
    """One linear map and three transposed convolutions of kernel 4 and stride 2, ending in a sigmoid.

    The linear map has no activation. No coordinate has a place in the image.
    """

    def __init__(self, d: int, *, height: int, width: int) -> None:
        super().__init__()
        self.cells = (height // REDUCTION, width // REDUCTION)
        self.expand = nn.Linear(d, WIDTHS[-1] * self.cells[0] * self.cells[1])
        self.convolutions = nn.ModuleList(
            nn.ConvTranspose2d(n_in, n_out, 4, stride=2, padding=1) for n_in, n_out in pairwise(WIDTHS[::-1])
        )

    def forward(self, z: Latents, *, generator: torch.Generator | None = None) -> Images:
        """Images in [0, 1]; unlike `AttentionDecoder` without noise, so nothing is drawn."""
        del generator
        hidden: Tensor = self.expand(z).unflatten(1, (WIDTHS[-1], *self.cells))
        *inner, last = self.convolutions
        for convolution in inner:
            hidden = functional.leaky_relu(convolution(hidden), SLOPE)
        return last(hidden).sigmoid()


class PixelNet(nn.Module):
    """A perceptron with the same weights at every pixel, on ``n_in`` numbers and the pixel's place."""

    def __init__(self, n_in: int, hidden: tuple[int, ...], n_out: int) -> None:
        super().__init__()
        self.n_in = n_in
        widths = (n_in + 2, *hidden, n_out)
        self.layers = nn.ModuleList(nn.Linear(before, after) for before, after in pairwise(widths))

    def forward(self, given: Float[Tensor, "B p n"], places: Places) -> Float[Tensor, "B P m"]:
        """Outputs at ``places``; ``given`` has one row per pixel, or a single one for all of them (p = 1)."""
        first, *rest = self.layers
        assert isinstance(first, nn.Linear)
        # What does not depend on the pixel, or not on the image, is multiplied only once.
        here = functional.linear(places, first.weight[:, self.n_in :], first.bias)
        value = functional.linear(given, first.weight[:, : self.n_in]) + here
        for layer in rest:
            value = layer(functional.leaky_relu(value, SLOPE))
        return value


class AttentionDecoder(nn.Module):
    """Nodes of ``group`` coordinates each, a softmax map per node, and a background with its own map.

    A pixel's colour is a function of its place and of what its maps attend to: the embedded coordinates of
    the nodes, and a learned vector of the background. ``background`` is the background's logit, a constant
    outside the weights. ``noise`` scales the Gumbel noise of training.
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
        rows, columns = torch.linspace(-1.0, 1.0, height), torch.linspace(-1.0, 1.0, width)
        places = torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1).flatten(0, 1)
        self.places: Tensor
        self.register_buffer("places", places, persistent=False)
        bound = (6 / (1 + FEATURES)) ** 0.5  # Xavier's, of one linear map 1 -> FEATURES a coordinate
        nn.init.uniform_(self.embed_weight, -bound, bound)

    def logits(self, z: Latents) -> Float[Tensor, "B P nodes"]:
        """Attention logits of each pixel, the background last."""
        nodes = self.attention(z[:, None], self.places)
        return torch.cat([nodes, torch.full_like(nodes[..., :1], self.background_logit)], -1)

    def maps(self, z: Latents) -> Maps:
        """Attention of the nodes, without that of the background."""
        return self.logits(z).softmax(-1)[..., :-1].transpose(1, 2)

    def forward(self, z: Latents, *, generator: torch.Generator | None = None) -> Images:
        """Images in [0, 1]; a generator adds the noise of training to the logits."""
        logits = self.logits(z)
        if generator is not None and self.noise:
            logits = logits + self.noise * _draw_gumbel(logits, generator)
        attention = logits.softmax(-1)
        embedded = (z[..., None] * self.embed_weight + self.embed_bias).unflatten(1, (self.n_nodes, -1))
        features = attention[..., :-1] @ embedded.flatten(2) + attention[..., -1:] * self.background
        return self.color(features, self.places).sigmoid().transpose(1, 2).unflatten(2, self.size)


CLAMP = 1e-6  # of the uniform numbers behind Gumbel noise
LARGEST_NOISE = 5.0
LEAST_SCALE = 1e-3  # of that noise, at pixels where all logits are equal


def _draw_gumbel(logits: Tensor, generator: torch.Generator) -> Tensor:
    """Standard Gumbel noise times the spread of the logits of each pixel, without gradient."""
    uniform = torch.rand(logits.shape, generator=generator).clamp(CLAMP, 1 - CLAMP)
    noise = (-(-uniform.log()).log()).clamp(-LARGEST_NOISE, LARGEST_NOISE)
    return logits.detach().std(-1, keepdim=True).clamp_min(LEAST_SCALE) * noise


TINY = 1e-8  # added to the mass of a map and to other divisors
NEAREST = 1e-6  # smallest distance of two points whose closing rate is measured


def compute_attention_centres(maps: Maps, places: Places) -> Points:
    """Centre of mass ``(y, x)`` of the squared maps."""
    weight = maps.square()
    return weight @ places / (weight.sum(-1, keepdim=True) + TINY)


def compute_moving_centres(maps: Maps, rates: Maps, places: Places) -> tuple[Points, Points]:
    """Centres of mass and their velocities [1/s], from the maps and their rates [1/s]."""
    weight, change = maps.square(), 2.0 * maps * rates
    mass = weight.sum(-1, keepdim=True) + TINY
    moment = weight @ places
    velocity = (change @ places * mass - moment * change.sum(-1, keepdim=True)) / mass.square()
    return moment / mass, velocity


def compute_centre_jacobian(decoder: AttentionDecoder, z: Latents) -> Float[Tensor, "B G 2 d"]:
    """Derivative of each centre with respect to each coordinate."""

    def place(state: Tensor) -> Tensor:
        return compute_attention_centres(decoder.maps(state[None]), decoder.places)[0]

    return torch.func.vmap(torch.func.jacrev(place))(z)


def penalize_unwarranted_change(map_rates: Maps, image_rates: Float[Tensor, "B 3 H W"]) -> Float[Tensor, ""]:
    """Mean rate of the maps [1/s], weighted by how little each pixel changes.

    A pixel's weight is one minus its rate of change, as a fraction of the largest in the batch.
    """
    change = torch.linalg.vector_norm(image_rates, dim=1).flatten(1)
    stillness = 1.0 - change / (change.max() + TINY)
    return (map_rates.abs() * stillness[:, None]).mean()


def compute_closing_rates(points: Points, velocities: Points) -> Float[Tensor, "B G G"]:
    """How fast each pair separates along the line between them, over its mean speed, within [-1, 1].

    Zero on the diagonal. The unit of time cancels.
    """
    apart = points[:, :, None] - points[:, None]
    relative = velocities[:, :, None] - velocities[:, None]
    speed = _norm(velocities)
    mean_speed = 0.5 * (speed[:, :, None] + speed[:, None])
    along = (relative * apart).sum(-1) / _norm(apart).clamp_min(NEAREST)
    return (along / mean_speed.clamp_min(TINY)).clamp(-1.0, 1.0)


def _norm(vectors: Tensor) -> Tensor:
    # The root has no finite slope at zero.
    return (vectors.square().sum(-1) + NEAREST**4).sqrt()


def measure_disagreement(first: Float[Tensor, "B G G"], second: Float[Tensor, "B G G"]) -> Float[Tensor, ""]:
    """Mean squared difference over all ordered pairs of different nodes; zero for a single node."""
    nodes = first.shape[1]
    return (first - second).square().sum((1, 2)).mean() / max(nodes * (nodes - 1), 1)
