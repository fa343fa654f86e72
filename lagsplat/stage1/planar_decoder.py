"""Two decoders over frozen latents at equal terms: Gaussians conditioned on the latent, or deformed by it."""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor, nn
from tqdm import tqdm

from lagsplat.array_types import Frames, Images, Latents
from lagsplat.io.files.artifact import StrPath, load_artifact, restore_module, save_artifact
from lagsplat.splat.gaussians import Gaussians, GaussianSlice
from lagsplat.splat.image_model import rasterize
from lagsplat.splat.losses import anisotropy
from lagsplat.stage1.autoencoder import to_images
from lagsplat.stage1.config import PlanarDecoderConfig, Stage1Config
from lagsplat.stage1.gaussian_initialization import place_gaussians
from lagsplat.stage1.objective import group_parameters, photometric_loss, set_rates

KIND, SCHEMA = "planar_decoder", 1
CONDITIONED, DEFORMED = "conditioned", "deformed"


@dataclass(frozen=True)
class DecoderArchitecture:
    """Kind and sizes of a planar decoder, and the limits of a deformed one.

    Raises:
        ValueError: there is no such kind.
    """

    kind: str
    n_gaussians: int
    d: int
    height: int  # of the image [px]
    width: int
    hidden: int  # width of the network's hidden layers
    shift_limit: float  # of a centre [px]
    shape_limit: float  # of the logarithm of a size

    def __post_init__(self) -> None:
        if self.kind not in (CONDITIONED, DEFORMED):
            raise ValueError(f"there is no decoder {self.kind!r}: choose {CONDITIONED} or {DEFORMED}")


class PlanarDecoder(nn.Module):
    """Decoder of planar Gaussians, conditioned on the latent or deformed by it."""

    def __init__(self, architecture: DecoderArchitecture) -> None:
        super().__init__()
        self.architecture = of = architecture
        self.kind, self.height, self.width = of.kind, of.height, of.width
        self.gaussians: Gaussians | DeformedGaussians
        if of.kind == CONDITIONED:
            self.gaussians = Gaussians(of.n_gaussians, of.d)
        else:
            limits = {"shift_limit": of.shift_limit, "shape_limit": of.shape_limit}
            self.gaussians = DeformedGaussians(of.n_gaussians, of.d, hidden=of.hidden, **limits)

    def slices(self, z: Latents) -> list[GaussianSlice]:
        """Slices of the latents: a single one if all share their shapes, else one per latent."""
        if isinstance(self.gaussians, Gaussians):
            return [self.gaussians.condition(z)]
        return self.gaussians.slices(z)

    def draw(self, slices: list[GaussianSlice], *, backend: str) -> Images:
        """Draw the slices as images."""
        height, width = self.height, self.width
        drawn = [rasterize(*scene, height=height, width=width, backend=backend) for scene in slices]
        return torch.cat(drawn)

    def jacobian(self, z: Tensor) -> Tensor:
        """Derivative of each centre by the latent at ``z`` (d,): (K, 2, d) [px per unit of z]."""
        if isinstance(self.gaussians, Gaussians):
            return self.gaussians.jacobian().detach()
        return self.gaussians.jacobian(z)


class PlanarFitReport(NamedTuple):
    """Training time [s], and mean loss over the last tenth of the steps."""

    wall_s: float
    loss: float


def fit_planar_decoder(
    kind: str,
    frames: Frames,
    latents: Float64[np.ndarray, "T d"],
    config: PlanarDecoderConfig,
    stage1: Stage1Config,
    *,
    seed: int,
) -> tuple[PlanarDecoder, PlanarFitReport]:
    """Fit a decoder of one kind to the training frames at their frozen raw latents.

    Both kinds start from the same planar Gaussians and use the same losses, batches, optimiser and step
    sizes, those of ``stage1``; only the effect of the latent on the Gaussians differs. Neither recycles
    Gaussians. A network gets the step size of the encoder.

    Raises:
        FloatingPointError: the loss is no longer finite.

    Source: paper, Appendix "Deformation-Field Decoder at Equal Budget".
    """
    begin = time.monotonic()
    decoder = start_planar_decoder(kind, frames, latents, config, stage1, seed=seed)
    stored, table = torch.from_numpy(np.array(frames)), torch.as_tensor(latents, dtype=torch.float32)
    parameters = dict(decoder.gaussians.named_parameters())
    network = [parameters.pop(name) for name in list(parameters) if name.startswith(("trunk", "head"))]
    optimizer = torch.optim.Adam(group_parameters(network, parameters, stage1.rate))
    losses = []
    with tqdm(total=config.steps, unit="step", desc=kind, mininterval=1.0) as bar:
        for step in range(config.steps):
            rng = np.random.default_rng([seed, step])
            picked = torch.as_tensor(rng.integers(len(stored), size=config.batch))
            set_rates(optimizer, stage1.rate, step=step, steps=config.steps)
            loss = _loss(decoder, table[picked], to_images(stored[picked]), stage1)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            losses.append(float(loss.detach()))
            bar.update()
            if not np.isfinite(losses[-1]):
                what = f"the {kind} decoder diverged at step {step}: the loss is {losses[-1]}"
                raise FloatingPointError(f"{what}. Lower stage1.rate.*")
    last = float(np.mean(losses[-max(1, len(losses) // 10) :]))
    return decoder.eval(), PlanarFitReport(time.monotonic() - begin, last)


def start_planar_decoder(
    kind: str,
    frames: Frames,
    latents: Float64[np.ndarray, "T d"],
    config: PlanarDecoderConfig,
    stage1: Stage1Config,
    *,
    seed: int,
) -> PlanarDecoder:
    """Build an untrained decoder; with equal seeds both kinds hold the same planar Gaussians."""
    torch.manual_seed(seed)
    _, height, width, _ = frames.shape
    architecture = DecoderArchitecture(
        kind=kind,
        n_gaussians=config.n_gaussians,
        d=latents.shape[1],
        height=height,
        width=width,
        hidden=config.hidden,
        shift_limit=config.shift_limit * width / 2,
        shape_limit=config.shape_limit,
    )
    decoder = PlanarDecoder(architecture)
    planar = Gaussians(architecture.n_gaussians, architecture.d)
    reference = np.asarray(frames[0]) / 255.0
    place_gaussians(planar, reference, latents, stage1.init, np.random.default_rng(seed))
    own = decoder.gaussians.state_dict()
    shared = {name: value for name, value in planar.state_dict().items() if name in own}
    decoder.gaussians.load_state_dict({**own, **shared})
    if isinstance(decoder.gaussians, DeformedGaussians):
        decoder.gaussians.latent_mean.copy_(torch.as_tensor(latents.mean(axis=0)))
        decoder.gaussians.latent_spread.copy_(torch.as_tensor(np.maximum(latents.std(axis=0), 1e-6)))
    return decoder


def _loss(decoder: PlanarDecoder, z: Latents, images: Images, stage1: Stage1Config) -> Tensor:
    slices, loss = decoder.slices(z), stage1.loss
    drawn = decoder.draw(slices, backend=stage1.backend)
    total = photometric_loss(drawn, images, loss)
    if loss.anisotropy:
        terms = [anisotropy(scene.covariance, limit=loss.anisotropy_limit) for scene in slices]
        total = total + loss.anisotropy * torch.stack(terms).mean()
    return total


def save_planar_decoder(path: StrPath, decoder: PlanarDecoder, header: Mapping[str, Any]) -> None:
    """Write the weights of a decoder with its architecture and a header."""
    header = {"kind": KIND, "schema": SCHEMA, **header, "architecture": asdict(decoder.architecture)}
    save_artifact(path, decoder.state_dict(), header)


def load_planar_decoder(path: StrPath) -> tuple[PlanarDecoder, dict[str, Any]]:
    """Read a decoder and its header; every setting comes from the file.

    Raises:
        ValueError: the file is no such decoder, or one of another schema.
    """
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    decoder = PlanarDecoder(DecoderArchitecture(**header["architecture"]))
    return restore_module(decoder, tensors, path), header


class DeformedGaussians(nn.Module):
    """``K`` planar Gaussians whose centres and shapes are free functions of the latent.

    One network maps the latent, in units of its spread, to a shift of every centre and a change of every
    covariance factor, all zero before training and softly limited: shifts to ``shift_limit`` [px], changes
    of shape to ``shape_limit``. Colours and opacities do not change. Lengths are in pixels.

    Source: paper, Appendix "Deformation-Field Decoder at Equal Budget"; Wu et al. 2024, arXiv:2310.08528.
    """

    latent_mean: Tensor
    latent_spread: Tensor

    def __init__(self, n: int, d: int, *, hidden: int, shift_limit: float, shape_limit: float) -> None:
        super().__init__()
        self.shift_limit, self.shape_limit = shift_limit, shape_limit
        self.center = nn.Parameter(torch.zeros(n, 2))
        self.shape_log_diagonal = nn.Parameter(torch.zeros(n, 2))
        self.shape_below = nn.Parameter(torch.zeros(n, 1))
        self.opacity_logit = nn.Parameter(torch.zeros(n))
        self.color_logit = nn.Parameter(torch.zeros(n, 3))
        self.background_logit = nn.Parameter(torch.zeros(3))
        self.trunk = nn.Sequential(nn.Linear(d, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.head = nn.Linear(hidden, 5 * n)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        self.register_buffer("latent_mean", torch.zeros(d))
        self.register_buffer("latent_spread", torch.ones(d))

    def centers(self, z: Latents) -> Float[Tensor, "B K 2"]:
        """Centres at each latent [px]."""
        return self.center + self._moved(z)[0]

    def slices(self, z: Latents) -> list[GaussianSlice]:
        """The planar Gaussians at each latent, one slice each because their shapes differ."""
        shifts, changes = self._moved(z)
        opacity, color = torch.sigmoid(self.opacity_logit)[None], torch.sigmoid(self.color_logit)
        found = []
        for shift, change in zip(shifts, changes, strict=True):
            a, c = (self.shape_log_diagonal + change[:, :2]).exp().unbind(1)
            b = self.shape_below[:, 0] + change[:, 2]
            covariance = torch.stack((a * a, a * b, b * b + c * c), dim=1)
            background = torch.sigmoid(self.background_logit)
            found.append(GaussianSlice((self.center + shift)[None], covariance, opacity, color, background))
        return found

    def jacobian(self, z: Float[Tensor, " d"]) -> Float[Tensor, "K 2 d"]:
        """Derivative of each centre with respect to the latent at ``z`` [px per unit of z]."""
        columns = [
            torch.func.jvp(lambda x: self.centers(x[None])[0], (z,), (along,))[1]
            for along in torch.eye(len(z), dtype=z.dtype, device=z.device)
        ]
        return torch.stack(columns, dim=-1).detach()

    def _moved(self, z: Latents) -> tuple[Float[Tensor, "B K 2"], Float[Tensor, "B K 3"]]:
        told = (z - self.latent_mean) / self.latent_spread
        out = self.head(self.trunk(told)).unflatten(1, (-1, 5))
        shift = self.shift_limit * torch.tanh(out[..., :2] / self.shift_limit)
        return shift, self.shape_limit * torch.tanh(out[..., 2:] / self.shape_limit)
