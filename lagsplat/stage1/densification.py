"""Recycle invisible Gaussians: split a parent with a large gradient, or teleport to a large error."""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latents
from lagsplat.splat.gaussians import Gaussians
from lagsplat.splat.projection import View
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.config import LifecycleConfig
from lagsplat.stage1.training_data import TrainingFrames, render_depth

SAMPLE = 512  # frames over which the peak opacity is taken
ERROR_SAMPLE = 64  # frames whose error attracts teleported Gaussians
SPLIT_OFFSET = 0.5  # of the principal standard deviation, each way: the pair keeps the parent's covariance
NEWBORN_OPACITY = 0.1
NEWBORN_SIGMA_PX = 1.0
NEWBORN_REACH = 0.5  # of the latent spread: it fits one state, and must not cover the others


def is_due(config: LifecycleConfig, *, step: int, steps: int) -> bool:
    """Whether Gaussians are recycled after this step."""
    return (
        config.every > 0
        and (step + 1) % config.every == 0
        and config.start * steps <= step < config.stop * steps
    )


@torch.no_grad()
def measure_peak_opacity(gaussians: Gaussians, z: Latents) -> Float[Tensor, " K"]:
    """The largest opacity each Gaussian reaches over the latents."""
    return gaussians.opacity_logit.sigmoid() * gaussians.gate(z).amax(0)


@torch.no_grad()
def densify_and_prune(
    autoencoder: Autoencoder,
    optimizer: torch.optim.Adam,
    footage: TrainingFrames,
    config: LifecycleConfig,
    *,
    rng: np.random.Generator,
) -> int:
    """Recycle every Gaussian that stays invisible over a sample of the clip; return their number.

    Source: paper, Implementation Details (training): split along the principal eigenvector of the full
    covariance, or teleport to a high-error region. The gradient as the signal to split: Kerbl et al. 2023,
    doi:10.1145/3592433.
    """
    picked = np.sort(rng.choice(len(footage), min(SAMPLE, len(footage)), replace=False))
    latents = footage.latents_of(autoencoder, picked)
    gaussians = autoencoder.gaussians
    dead = measure_peak_opacity(gaussians, latents) < config.peak_opacity
    if not dead.any() or dead.all():
        return int(dead.sum())
    slots = dead.nonzero().flatten()
    n_split = min(round(config.split_share * len(slots)), int((~dead).sum()))
    # Parents are the visible ones with the largest mean square gradient of the centre, which Adam keeps.
    state = optimizer.state.get(gaussians.center)
    pull = state["exp_avg_sq"].sum(1) if state else torch.zeros(gaussians.n, device=dead.device)
    parents = torch.where(dead, -1.0, pull).topk(n_split).indices
    children, strays = slots[:n_split], slots[n_split:]
    split_gaussians(gaussians, parents, children)
    if len(strays):
        teleport_gaussians(autoencoder, footage, strays, rng)
    renumber_gaussians(gaussians, optimizer, parents, children, strays)
    return len(slots)


def split_gaussians(gaussians: Gaussians, parents: Tensor, slots: Tensor) -> None:
    """Replace each parent by two along the principal eigenvector of its covariance in latent and space.

    The two centres lie half a standard deviation either way and the variance along the axis shrinks by as
    much, so the pair has the parent's mean and covariance, and together the parent's opacity.
    """
    d, size = gaussians.d, gaussians.d + gaussians.space
    factor = torch.zeros(len(parents), size, size, device=parents.device, dtype=torch.float64)
    factor[:, :d, :d] = torch.linalg.inv(gaussians.precision_factor()[parents].double())
    factor[:, d:, :d] = gaussians.coupling[parents].double()
    factor[:, d:, d:] = gaussians.shape_factor()[parents].double()
    # From the factor itself, never from the covariance, which may be singular to rounding.
    vectors, deviations, _ = torch.linalg.svd(factor)
    axis = vectors[..., 0] * deviations[..., :1] * SPLIT_OFFSET
    deviations = deviations.clamp_min(1e-9 * deviations[..., :1])
    deviations[..., 0] *= math.sqrt(1 - SPLIT_OFFSET**2)
    upper = torch.linalg.qr((vectors * deviations[..., None, :]).mT).R
    child = (upper * upper.diagonal(dim1=1, dim2=2).sign()[..., None]).mT

    precision = torch.linalg.inv(child[:, :d, :d])
    row, column = torch.tril_indices(d, d, offset=-1)
    below, left = torch.tril_indices(gaussians.space, gaussians.space, offset=-1) + d
    opacity = 1 - (1 - gaussians.opacity_logit[parents].sigmoid().clamp_max(0.999)).sqrt()
    shared = {
        "precision_log_diagonal": precision.diagonal(dim1=1, dim2=2).log(),
        "precision_below": precision[:, row, column],
        "coupling": child[:, d:, :d],
        "shape_log_diagonal": child.diagonal(dim1=1, dim2=2)[:, d:].log(),
        "shape_below": child[:, below, left],
        "opacity_logit": opacity.logit(),
        "color_logit": gaussians.color_logit[parents],
    }
    middle = torch.cat((gaussians.latent_center[parents], gaussians.center[parents]), dim=1)
    for target, center in ((parents, middle + axis), (slots, middle - axis)):
        for name, value in {**shared, "latent_center": center[:, :d], "center": center[:, d:]}.items():
            parameter = getattr(gaussians, name)
            parameter[target] = value.to(parameter)


def teleport_gaussians(
    autoencoder: Autoencoder, footage: TrainingFrames, slots: Tensor, rng: np.random.Generator
) -> None:
    """Move each Gaussian to a pixel of a frame, drawn in proportion to the error there, and to its latent.

    In space the frames include novel views, and the Gaussian goes to the rendered depth of the pixel.
    """
    gaussians = autoencoder.gaussians
    picked = np.sort(rng.choice(len(footage), min(ERROR_SAMPLE, len(footage)), replace=False))
    images, latents, view = footage.shots(autoencoder, picked, rng)
    error = (autoencoder.decode(latents, view=view) - images).abs().mean(1)
    weight = error.flatten().double().cpu().numpy() + 1e-12
    where = rng.choice(len(weight), len(slots), p=weight / weight.sum())
    places = np.unravel_index(where, error.shape)
    frame, row, column = (torch.as_tensor(axis, device=slots.device) for axis in places)
    pixels = torch.stack((column, row), 1).float() + 0.5
    if gaussians.space == 3:
        parts = view or autoencoder.filmed_view(latents)
        view = View(*(part.expand(len(latents), *part.shape[1:]) for part in parts))
        depth = render_depth(autoencoder, latents, view)[frame, row, column]
        pixels = view.of(frame).unproject(pixels, depth)
    gaussians.center[slots] = pixels
    gaussians.latent_center[slots] = latents[frame]
    gaussians.precision_log_diagonal[slots] = -(NEWBORN_REACH * latents.std(0).clamp_min(1e-3)).log()
    gaussians.precision_below[slots] = 0
    gaussians.coupling[slots] = 0
    gaussians.shape_log_diagonal[slots] = math.log(NEWBORN_SIGMA_PX)
    gaussians.shape_below[slots] = 0
    gaussians.opacity_logit[slots] = math.log(NEWBORN_OPACITY / (1 - NEWBORN_OPACITY))
    gaussians.color_logit[slots] = images[frame, :, row, column].clamp(0.01, 0.99).logit()


def renumber_gaussians(
    gaussians: Gaussians, optimizer: torch.optim.Adam, parents: Tensor, children: Tensor, strays: Tensor
) -> None:
    """Put each child right after its parent, and reset Adam's moments of recycled Gaussians and parents.

    Gaussians are drawn in index order. A child at the index of the dead Gaussian it replaces would be drawn
    in front of what covered its parent, or behind what its parent covered. A child takes over its parent's
    mean square gradient; teleported ``strays`` start from zero. No momentum is kept, because its direction
    belonged to the former place.
    """
    place = torch.arange(gaussians.n, dtype=torch.float64, device=parents.device)
    place[children] = place[parents] + 0.5
    order = place.argsort(stable=True)
    for name, parameter in gaussians.named_parameters():
        if name == "background_logit":
            continue
        rows = [parameter]
        if state := optimizer.state.get(parameter):
            mean, square = state["exp_avg"], state["exp_avg_sq"]
            mean[torch.cat((parents, children, strays))] = 0
            square[children] = square[parents]
            square[strays] = 0
            rows += [mean, square]
        for values in rows:
            values.copy_(values[order])
