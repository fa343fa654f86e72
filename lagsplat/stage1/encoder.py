"""The encoder, and its initial weights: smooth filters and a latent that follows the motion without a fold.

Few, large filters make the latent a continuous function of the motion. Training sharpens a latent but rarely
unfolds it: two states that start at one latent tend to stay there. A readout of random features, even of
their principal components, folds as soon as an object moves by more than its size. Geodesic distances along
the video do not fold.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.ndimage import gaussian_filter
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.array_types import Images, Latents

POOLED = 4  # the last feature map is pooled to POOLED x POOLED, whatever the image


class Encoder(nn.Module):
    """Three large convolutions of stride 2 with ELU, a pool to 4x4, one linear layer to the latent.

    No normalisation layer and no output activation: the chart computes its own statistics afterwards. Each
    latent is less a quadratic function ``bend`` of those before it, which is zero until `straighten_encoder`
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
def measure_small_moves(encoder: Encoder, images: Images, *, limit: float | None) -> Iterator[None]:
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


BLUR_SHARE = 1 / 6  # standard deviation of the blur of a starting filter, in sides of the filter
NEIGHBORS = 15  # nearest frames, between which geodesic distances are summed
COMPARED_PX = 48  # longer side of the frames that are compared
# set by hand, with the simulated double pendulum, bag and arms in view
BLURRED_SHARE = 1 / 12  # standard deviation of the blur with which they are compared, in that side
SPARE_AXES = 4  # geodesic axes beyond those asked for, which may repeat an axis before
RIDGE = 1e-4  # regularisation of the readout, relative to the strongest feature


@torch.no_grad()
def initialize_encoder(encoder: Encoder, images: Images) -> None:
    """Initialise the encoder, in place, as the best smooth readout of geodesic distances along the video.

    The random filters are blurred, and the linear layer is the least-squares map from their features to the
    geodesic coordinates of the images. With fewer distinct images than axes the others start at zero.
    """
    draw_smooth_filters(encoder)
    fit_readout(encoder, images, compute_geodesic_coordinates(images, encoder.head.out_features))


@torch.no_grad()
def straighten_encoder(encoder: Encoder, images: Images) -> None:
    """Make no latent of the images a quadratic function of those before it, by ``bend`` and in place."""
    bent = encoder.head(encoder.features(images)).double().cpu().numpy()
    straight = np.ones((len(bent), 1))
    for k in range(1, bent.shape[1]):
        straight = np.c_[straight, bent[:, k - 1] - _predict(straight, encoder.bend[k - 1])]
        columns = _multiply_pairs(straight)
        weight = np.linalg.lstsq(columns, bent[:, k], rcond=None)[0]
        weight[0] -= (columns @ weight).mean()  # the mean stays
        encoder.bend[k].zero_()[: k + 1, : k + 1] = torch.as_tensor(weight.reshape(k + 1, k + 1))


def _predict(straight: Float64[np.ndarray, "B k"], bend: Tensor) -> Float64[np.ndarray, " B"]:
    size = straight.shape[1]
    quadratic = bend[:size, :size].double().cpu().numpy()
    return np.einsum("bi,ij,bj->b", straight, quadratic, straight)


def _multiply_pairs(z: Float64[np.ndarray, "B k"]) -> Float64[np.ndarray, "B n"]:
    return (z[:, :, None] * z[:, None]).reshape(len(z), -1)


@torch.no_grad()
def fit_readout(encoder: Encoder, images: Images, target: Float64[np.ndarray, "B d"]) -> None:
    """Set the linear layer, in place, to the least-squares map from the features of images to ``target``."""
    features = encoder.features(images).double()
    mean, middle = features.mean(0), torch.as_tensor(target.mean(0)).to(features)
    features = features - mean
    gram = features.T @ features
    scale = max(float(torch.linalg.eigvalsh(gram)[-1]), 1e-30)
    identity = torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    aim = features.T @ (torch.as_tensor(target).to(features) - middle)
    weight = torch.linalg.solve(gram + RIDGE * scale * identity, aim).T
    encoder.head.weight.copy_(weight)
    encoder.head.bias.copy_(middle - weight @ mean)


@torch.no_grad()
def draw_smooth_filters(encoder: Encoder) -> None:
    """Blur the convolutions, in place, and keep the norm of each bank's weights.

    A continuous encoder needs smooth filters (Zhu et al. 2025; paper eq. (recon_loss) penalises rough ones),
    so it starts with them.
    """
    for bank in encoder.filters():
        side = bank.shape[-1]
        offset = torch.arange(side, dtype=bank.dtype)
        blur = torch.exp(-0.5 * ((offset[:, None] - offset) / (BLUR_SHARE * side)) ** 2)
        smooth = blur @ bank @ blur
        bank.copy_(smooth * (bank.norm() / smooth.norm().clamp_min(1e-30)))


def compute_geodesic_coordinates(images: Images, d: int) -> Float64[np.ndarray, "B d"]:
    """Straight coordinates of geodesic distances along the video, with zero mean and unit variance.

    Images are blurred before they are compared: the distance between sharp images of an object stops growing
    once it has moved by its own width, and what is saturated looks curved. Curvature that remains makes the
    second geodesic coordinate a square of the first. So each coordinate is the largest part of the geodesic
    ones that is no quadratic function of the coordinates before it.

    Source: Isomap, Tenenbaum et al. 2000, doi:10.1126/science.290.5500.2319; repeated directions, Dsilva et
    al. 2018, doi:10.1016/j.acha.2015.06.008.
    """
    shrink = min(1.0, COMPARED_PX / max(images.shape[2:]))
    size = [max(1, round(shrink * side)) for side in images.shape[2:]]
    small = functional.interpolate(images, size=size, mode="area").double().cpu().numpy()
    blurred = gaussian_filter(small, BLURRED_SHARE * max(size), axes=(2, 3))
    pixels = blurred.reshape(len(blurred), -1)
    distinct = len(np.unique(pixels, axis=0))
    n_axes = min(d, distinct - 1)
    coordinates = np.zeros((len(pixels), d))
    if n_axes > 0:
        from sklearn.manifold import Isomap  # a second to import, which only this needs

        # The dense solver, because the iterative solver starts from a random vector.
        near = min(NEIGHBORS, len(pixels) - 1)
        n_components = min(d + SPARE_AXES, distinct - 1)
        isomap = Isomap(n_neighbors=near, n_components=n_components, eigen_solver="dense")
        embedded = isomap.fit_transform(pixels)
        left = embedded - embedded.mean(0)
        for k in range(n_axes):
            found = left @ np.linalg.svd(left, full_matrices=False)[2][0]
            coordinates[:, k] = (found - found.mean()) / max(found.std(), 1e-12)
            columns = _multiply_pairs(np.c_[np.ones(len(found)), coordinates[:, : k + 1]])
            left = embedded - columns @ np.linalg.lstsq(columns, embedded, rcond=None)[0]
    return coordinates
