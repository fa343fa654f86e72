"""Initial weights of the encoder, and latents of a free motion without squares while it is trained.

Few, large filters make the latent a continuous function of the motion. Training sharpens a latent but rarely
unfolds it: two states that start at one latent tend to stay there. A readout of random features, even of
their principal components, folds as soon as an object moves by more than its size. The linear response to
inputs does not fold, nor do geodesic distances along the video where a motion is not driven.
"""

import numpy as np
import torch
from jaxtyping import Float64
from scipy.ndimage import gaussian_filter
from torch import Tensor
from torch.nn import functional

from lagsplat.array_types import Images
from lagsplat.stage1.autoencoder import CHUNK
from lagsplat.stage1.encoder import Encoder
from lagsplat.stage1.linear_response import LinearResponse, fit_linear_response
from lagsplat.stage1.training_data import TrainingFrames

BLUR_SHARE = 1 / 6  # standard deviation of the blur of a starting filter, in sides of the filter
NEIGHBORS = 15  # nearest frames, between which geodesic distances are summed
COMPARED_PX = 48  # longer side of the frames that are compared
# set by hand, with the simulated double pendulum, bag and arms in view
BLURRED_SHARE = 1 / 12  # standard deviation of the blur with which they are compared, in that side
SPARE_AXES = 4  # geodesic axes beyond those asked for, which may repeat an axis before
SAMPLE = 1024  # frames whose geodesic distances are measured
FOLLOWED = 4096  # frames whose features are compared with the inputs
DRAWS = 8  # banks of filters: of one, the readout of a pendulum once left nine times as much as of the others
RIDGE = 1e-4  # regularisation of the readout, relative to the strongest feature


@torch.no_grad()
def initialize_encoder(encoder: Encoder, footage: TrainingFrames, *, seed: int) -> LinearResponse | None:
    """Initialise the encoder, in place, with blurred random filters and the best readout of their features.

    That is the linear response to the inputs, which is returned, or where there is none, the least-squares
    map to the geodesic coordinates of some frames. With fewer distinct frames than axes the others start at
    zero. Few random filters may miss the motion, so the best of `DRAWS` are taken.
    """
    banks = [_draw_bank(encoder, seed=seed, draw=draw) for draw in range(DRAWS)]
    followed = [(bank, _measure_response(encoder, footage, bank, seed=seed)) for bank in banks]
    driven = [(bank, response) for bank, response in followed if response is not None]
    if driven:
        bank, response = min(driven, key=lambda each: float(each[1].variance.mean()))
        encoder.convolutions.load_state_dict(bank)
        encoder.head.weight.copy_(torch.as_tensor(response.weights.T))
        encoder.head.bias.copy_(torch.as_tensor(-response.mean_features @ response.weights))
        return response
    images = footage.images(footage.sample(SAMPLE, seed=seed)).cpu()
    target = compute_geodesic_coordinates(images, encoder.head.out_features)
    left = []
    for bank in banks:
        encoder.convolutions.load_state_dict(bank)
        left.append(fit_readout(encoder, images, target))
    encoder.convolutions.load_state_dict(banks[int(np.argmin(left))])
    fit_readout(encoder, images, target)
    return None


def _draw_bank(encoder: Encoder, *, seed: int, draw: int) -> dict[str, Tensor]:
    """Smooth random filters: the encoder's own first, then others, apart from torch's stream of numbers."""
    if draw:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(np.random.default_rng([seed, draw]).integers(2**62)))
            for convolution in encoder.convolutions:
                convolution.reset_parameters()  # type: ignore[operator]
    draw_smooth_filters(encoder)
    return {name: value.clone() for name, value in encoder.convolutions.state_dict().items()}


def _measure_response(
    encoder: Encoder, footage: TrainingFrames, bank: dict[str, Tensor], *, seed: int
) -> LinearResponse | None:
    if footage.history is None:
        return None
    encoder.convolutions.load_state_dict(bank)
    picked = footage.sample(FOLLOWED, seed=seed)
    parts = np.array_split(picked, -(-len(picked) // CHUNK))
    features = [encoder.features(footage.images(part).cpu()).double().numpy() for part in parts]
    history = footage.history.before(picked)
    return fit_linear_response(np.concatenate(features), history, encoder.head.out_features)


@torch.no_grad()
def remove_squares(encoder: Encoder, images: Images) -> None:
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
def fit_readout(encoder: Encoder, images: Images, target: Float64[np.ndarray, "B d"]) -> float:
    """Set the linear layer, in place, to the least-squares map from the features of images to ``target``.

    Returns the mean squared error that is left.
    """
    features = encoder.features(images).double()
    mean, middle = features.mean(0), torch.as_tensor(target.mean(0)).to(features)
    features = features - mean
    gram = features.T @ features
    scale = max(float(torch.linalg.eigvalsh(gram)[-1]), 1e-30)
    identity = torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    wanted = torch.as_tensor(target).to(features) - middle
    weight = torch.linalg.solve(gram + RIDGE * scale * identity, features.T @ wanted).T
    encoder.head.weight.copy_(weight)
    encoder.head.bias.copy_(middle - weight @ mean)
    return float((features @ weight.T - wanted).square().mean())


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
