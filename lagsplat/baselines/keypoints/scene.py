"""Planar Gaussians with a place, a shape, a colour and a motion feature: the forecaster's picture."""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.shapes import Frames
from lagsplat.splat.backend import rasterizer

FEATURE_START = 1e-3
FLAT_SHARE = 0.2  # probability given to every pixel, edges and moving pixels taking the rest


class Scene(nn.Module):
    """``N`` Gaussians in half widths of the image: x from -1 to 1, y likewise about the middle row.

    Sizes are in pixels. Only places and angles move with time; colour, opacity and size never do. They are
    drawn in the order of their index by the image model of the whole package.
    """

    def __init__(self, n: int, feature: int, *, height: int, width: int) -> None:
        super().__init__()
        self.height, self.width = height, width
        self.place = nn.Parameter(torch.zeros(n, 2))
        self.log_scale = nn.Parameter(torch.zeros(n, 2))
        self.angle = nn.Parameter(torch.zeros(n, 1))
        self.color_logit = nn.Parameter(torch.zeros(n, 3))
        self.opacity_logit = nn.Parameter(torch.zeros(n))
        self.background_logit = nn.Parameter(torch.zeros(3))
        self.feature = nn.Parameter(torch.zeros(n, feature))

    def draw(
        self, place: Float[Tensor, "N 2"], angle: Float[Tensor, "N 1"], *, backend: str
    ) -> Float[Tensor, "1 3 H W"]:
        """The picture with its Gaussians at ``place`` [half widths], turned to ``angle`` [rad]."""
        half = self.width / 2
        means = place * half + place.new_tensor([half, self.height / 2])
        return rasterizer(backend, place.device)(
            means[None],
            self.covariance(angle),
            torch.sigmoid(self.opacity_logit)[None],
            torch.sigmoid(self.color_logit),
            torch.sigmoid(self.background_logit),
            height=self.height,
            width=self.width,
        )

    def covariance(self, angle: Float[Tensor, "N 1"]) -> Float[Tensor, "N 3"]:
        """Covariances xx, xy, yy [px^2] at these angles."""
        first, second = self.log_scale.mul(2).exp().unbind(1)
        cos, sin = torch.cos(angle[:, 0]), torch.sin(angle[:, 0])
        return torch.stack(
            (
                cos * cos * first + sin * sin * second,
                cos * sin * (first - second),
                sin * sin * first + cos * cos * second,
            ),
            dim=1,
        )


@torch.no_grad()
def scatter(scene: Scene, frames: Frames, *, sigma: float, opacity: float, rng: np.random.Generator) -> None:
    """Place the Gaussians where the first frame has edges and where frames differ, in the colours there.

    ``sigma`` is their size over the image height.
    """
    first, n = np.asarray(frames[0]) / 255.0, len(scene.place)
    spread = np.asarray(frames[:: max(1, len(frames) // 50)]).std(axis=0).mean(-1)
    edges = np.abs(np.stack(np.gradient(np.pad(first.mean(-1), 1, mode="edge")))).sum(0)[1:-1, 1:-1]
    busy = edges / max(edges.sum(), 1e-12) + spread / max(spread.sum(), 1e-12)
    density = (1 - FLAT_SHARE) * busy / max(busy.sum(), 1e-12) + FLAT_SHARE / busy.size
    pixels = rng.choice(busy.size, n, p=(density / density.sum()).ravel())
    rows, columns = np.divmod(pixels, scene.width)
    at = np.stack((columns, rows), 1) + rng.random((n, 2))
    half = scene.width / 2
    scene.place.copy_(torch.as_tensor((at - [half, scene.height / 2]) / half))
    scene.log_scale.fill_(math.log(sigma * scene.height))
    scene.opacity_logit.fill_(math.log(opacity / (1 - opacity)))
    scene.color_logit.copy_(torch.as_tensor(np.clip(first[rows, columns], 0.01, 0.99)).logit())
    scene.background_logit.copy_(torch.as_tensor(first.mean((0, 1)).clip(0.01, 0.99)).logit())
    drawn = rng.uniform(-FEATURE_START, FEATURE_START, scene.feature.shape)
    scene.feature.copy_(torch.as_tensor(drawn))
