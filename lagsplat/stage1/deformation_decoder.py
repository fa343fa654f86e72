"""Two decoders over frozen latents at equal terms: Gaussians conditioned on the latent, or deformed by it."""

import time
from collections.abc import Mapping
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
from lagsplat.stage1.config import FieldConfig, Stage1Config
from lagsplat.stage1.gaussian_initialization import place_gaussians
from lagsplat.stage1.objective import group_parameters, photometric_loss, set_rates

KIND, SCHEMA = "field", 1
CONDITIONED, DEFORMED = "conditioned", "deformed"


class DeformationField(nn.Module):
    """Decoder of planar Gaussians, conditioned or deformed (``kind``), and its image size."""

    def __init__(self, kind: str, n: int, d: int, config: FieldConfig, *, height: int, width: int) -> None:
        super().__init__()
        self.kind, self.height, self.width = kind, height, width
        self.gaussians: Gaussians | DeformedGaussians
        if kind == CONDITIONED:
            self.gaussians = Gaussians(n, d)
        elif kind == DEFORMED:
            limits = {"shift_limit": config.shift_limit * width / 2, "shape_limit": config.shape_limit}
            self.gaussians = DeformedGaussians(n, d, hidden=config.hidden, **limits)
        else:
            raise ValueError(f"there is no decoder {kind!r}: choose {CONDITIONED} or {DEFORMED}")

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


class DeformationFitReport(NamedTuple):
    """Training time [s], and mean loss over the last tenth of the steps."""

    wall_s: float
    loss: float


def fit_deformation_field(
    kind: str,
    frames: Frames,
    latents: Float64[np.ndarray, "T d"],
    config: FieldConfig,
    stage1: Stage1Config,
    *,
    seed: int,
) -> tuple[DeformationField, DeformationFitReport]:
    """Fit a decoder of one kind to the training frames at their frozen raw latents.

    Both kinds start from the same planar Gaussians and use the same losses, batches, optimiser and step
    sizes, those of ``stage1``; only the effect of the latent on the Gaussians differs. Neither recycles
    Gaussians. A network gets the step size of the encoder.

    Raises:
        FloatingPointError: the loss is no longer finite.

    Source: paper, Appendix "Deformation-Field Decoder at Equal Budget".
    """
    begin = time.monotonic()
    field = start_deformation_field(kind, frames, latents, config, stage1, seed=seed)
    stored, table = torch.from_numpy(np.array(frames)), torch.as_tensor(latents, dtype=torch.float32)
    parameters = dict(field.gaussians.named_parameters())
    network = [parameters.pop(name) for name in list(parameters) if name.startswith(("trunk", "head"))]
    optimizer = torch.optim.Adam(group_parameters(network, parameters, stage1.rate))
    losses = []
    with tqdm(total=config.steps, unit="step", desc=kind, mininterval=1.0) as bar:
        for step in range(config.steps):
            rng = np.random.default_rng([seed, step])
            picked = torch.as_tensor(rng.integers(len(stored), size=config.batch))
            set_rates(optimizer, stage1.rate, step=step, steps=config.steps)
            loss = _loss(field, table[picked], to_images(stored[picked]), stage1)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            losses.append(float(loss.detach()))
            bar.update()
            if not np.isfinite(losses[-1]):
                what = f"the {kind} decoder diverged at step {step}: the loss is {losses[-1]}"
                raise FloatingPointError(f"{what}. Lower stage1.rate.*")
    last = float(np.mean(losses[-max(1, len(losses) // 10) :]))
    return field.eval(), DeformationFitReport(time.monotonic() - begin, last)


def start_deformation_field(
    kind: str,
    frames: Frames,
    latents: Float64[np.ndarray, "T d"],
    config: FieldConfig,
    stage1: Stage1Config,
    *,
    seed: int,
) -> DeformationField:
    """Build an untrained decoder; with equal seeds both kinds hold the same planar Gaussians."""
    torch.manual_seed(seed)
    _, height, width, _ = frames.shape
    n, d = config.n_gaussians, latents.shape[1]
    field = DeformationField(kind, n, d, config, height=height, width=width)
    planar = Gaussians(n, d)
    reference = np.asarray(frames[0]) / 255.0
    place_gaussians(planar, reference, latents, stage1.init, np.random.default_rng(seed))
    own = field.gaussians.state_dict()
    shared = {name: value for name, value in planar.state_dict().items() if name in own}
    field.gaussians.load_state_dict({**own, **shared})
    if isinstance(field.gaussians, DeformedGaussians):
        field.gaussians.latent_mean.copy_(torch.as_tensor(latents.mean(axis=0)))
        field.gaussians.latent_spread.copy_(torch.as_tensor(np.maximum(latents.std(axis=0), 1e-6)))
    return field


def _loss(field: DeformationField, z: Latents, images: Images, stage1: Stage1Config) -> Tensor:
    slices, loss = field.slices(z), stage1.loss
    drawn = field.draw(slices, backend=stage1.backend)
    total = photometric_loss(drawn, images, loss)
    if loss.anisotropy:
        terms = [anisotropy(scene.covariance, limit=loss.anisotropy_limit) for scene in slices]
        total = total + loss.anisotropy * torch.stack(terms).mean()
    return total


def save_deformation_field(path: StrPath, field: DeformationField, header: Mapping[str, Any]) -> None:
    """Write the weights of a decoder with its header."""
    shape = {"kind": field.kind, "height": field.height, "width": field.width}
    save_artifact(path, field.state_dict(), {"kind": KIND, "schema": SCHEMA, **header, "field": shape})


def load_deformation_field(
    path: StrPath, config: FieldConfig, *, d: int
) -> tuple[DeformationField, dict[str, Any]]:
    """Read a decoder and its header."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    field = DeformationField(n=config.n_gaussians, d=d, config=config, **header["field"])
    return restore_module(field, tensors, path), header


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
