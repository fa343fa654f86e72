"""What training asks of the attention maps: to stand still with the image, and to move as the law says."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.baselines.abcd import Maps

TINY = 1e-8
NEAREST = 1e-6  # least distance of two points whose approach is measured

Points = Float[Tensor, "B G 2"]


def unwarranted_change(map_rates: Maps, image_rates: Float[Tensor, "B 3 H W"]) -> Float[Tensor, ""]:
    """Mean rate of the maps [1/s], weighted by how still each pixel is.

    A pixel's stillness is one less its rate of change, as a fraction of the largest in the whole batch.
    """
    change = torch.linalg.vector_norm(image_rates, dim=1).flatten(1)
    stillness = 1.0 - change / (change.max() + TINY)
    return (map_rates.abs() * stillness[:, None]).mean()


def closing_rates(points: Points, velocities: Points) -> Float[Tensor, "B G G"]:
    """How fast each pair separates along the line between them, over its mean speed, within [-1, 1].

    Zero on the diagonal. The unit of time cancels.
    """
    apart = points[:, :, None] - points[:, None]
    relative = velocities[:, :, None] - velocities[:, None]
    distance = _norm(apart).clamp_min(NEAREST)
    speed = _norm(velocities)
    mean_speed = 0.5 * (speed[:, :, None] + speed[:, None])
    along = (relative * apart).sum(-1) / distance
    return (along / mean_speed.clamp_min(TINY)).clamp(-1.0, 1.0)


def disagreement(first: Float[Tensor, "B G G"], second: Float[Tensor, "B G G"]) -> Float[Tensor, ""]:
    """Mean squared difference over all ordered pairs of different nodes; zero where there is one node."""
    nodes = first.shape[1]
    pairs = max(nodes * (nodes - 1), 1)
    return (first - second).square().sum((1, 2)).mean() / pairs


def _norm(vectors: Tensor) -> Tensor:
    # The root of zero has no slope.
    return (vectors.square().sum(-1) + NEAREST**4).sqrt()
