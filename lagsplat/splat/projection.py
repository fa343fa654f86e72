"""Project Gaussians of space into cameras: planar Gaussians, one set per image, nearest first.

A Gaussian with centre ``m`` and covariance ``S`` in camera coordinates is drawn at the projection of ``m``.
Its shape is that of the projection linearised at the centre, ``A S A^T`` with

    A = [[f_x / z, 0, -f_x x / z^2],
         [0, f_y / z, -f_y y / z^2]]

where ``x / z`` and ``y / z`` are clipped at `MARGIN` of half the image beyond its edges, because the
linearisation diverges there. Gaussians nearer than `NEAR` are not drawn. The result follows
`lagsplat.splat.image_model`, with depth order as index order.

Source: Zwicker et al. 2002, doi:10.1109/TVCG.2002.1021576; limits as in gsplat 1.5, classic mode.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.views.camera import Camera

NEAR = 0.01  # [unit of length]
MARGIN = 0.3
SQUARE = (0, 1, 3, 1, 2, 4, 3, 4, 5)
"""Position of each entry of a symmetric matrix in its lower triangle, row by row."""


class View(NamedTuple):
    """Cameras of a batch of images: world-to-camera ``R x + t``, focal lengths and principal points [px]."""

    rotation: Float[Tensor, "B 3 3"]
    translation: Float[Tensor, "B 3"]
    focal: Float[Tensor, "B 2"]
    middle: Float[Tensor, "B 2"]

    def resized(self, across: float, down: float) -> "View":
        """The same cameras with ``across`` times as many columns and ``down`` times as many rows."""
        factor = self.focal.new_tensor([across, down])
        return self._replace(focal=self.focal * factor, middle=self.middle * factor)

    def of(self, images: Tensor) -> "View":
        """The cameras of the images with these indices."""
        return View(*(part[images] for part in self))

    def unproject(self, pixels: Float[Tensor, "B 2"], depth: Float[Tensor, " B"]) -> Float[Tensor, "B 3"]:
        """World points at these image points of each camera, at the given depth."""
        ahead = torch.cat([(pixels - self.middle) / self.focal, torch.ones_like(pixels[:, :1])], dim=1)
        inside = depth[:, None] * ahead - self.translation
        return (self.rotation.mT @ inside[..., None])[..., 0]


def make_view(cameras: Sequence[Camera]) -> View:
    """Convert cameras to float32 tensors."""
    parts = [
        np.stack([camera.rotation for camera in cameras]),
        np.stack([-camera.rotation @ camera.position for camera in cameras]),
        np.array([camera.focal for camera in cameras]),
        np.array([camera.middle for camera in cameras]),
    ]
    return View(*(torch.as_tensor(part, dtype=torch.float32) for part in parts))


def project(scene: GaussianSlice, view: View, *, height: int, width: int) -> GaussianSlice:
    """Project Gaussians of space to the planar ones that each image's camera sees, nearest first.

    Differentiable in all but the order. Colours, of any number of channels, are sorted along.

    Raises:
        ValueError: the Gaussians are planar already, or the numbers of cameras and images differ.
    """
    if scene.means.shape[2] != 3 or len(view.rotation) not in (1, len(scene.means)):
        raise ValueError(
            f"{len(view.rotation)} cameras for {len(scene.means)} images of Gaussians in "
            f"{scene.means.shape[2]} dimensions: give Gaussians of space, and one camera an image or for all"
        )
    means = scene.means
    inside = torch.baddbmm(view.translation[:, None], means, view.rotation.mT.expand(len(means), 3, 3))
    drawn = (inside[..., 2] >= NEAR) & inside.isfinite().all(2)
    # Replaced before the division: autograd would turn an unused infinity into NaN.
    inside = torch.where(drawn[..., None], inside, inside.new_tensor([0.0, 0.0, 1.0]))
    flat = torch.addcmul(view.middle[:, None], view.focal[:, None], inside[..., :2] / inside[..., 2:])
    shape = _flatten(scene.covariance, inside, view, height, width)
    opacity = torch.where(drawn, scene.opacity, 0)
    order = torch.where(drawn, inside[..., 2], torch.inf).detach().argsort(dim=1, stable=True)
    color = scene.color.expand(*opacity.shape, scene.color.shape[-1])
    means, shape, color = (
        part.gather(1, order[..., None].expand(*order.shape, part.shape[2])) for part in (flat, shape, color)
    )
    return GaussianSlice(means, shape, opacity.gather(1, order), color, scene.background)


def compute_depths(means: Float[Tensor, "B K 3"], view: View) -> Float[Tensor, "B K"]:
    """Depth of each centre ahead of its camera."""
    ahead = view.rotation[:, 2].expand(len(means), 3)
    return torch.einsum("bki,bi->bk", means, ahead) + view.translation[:, 2:]


def _flatten(
    covariance: Float[Tensor, "K 6"], inside: Float[Tensor, "B K 3"], view: View, height: int, width: int
) -> Float[Tensor, "B K 3"]:
    """Covariance of the projected Gaussians [px^2], as xx, xy, yy."""
    size = inside.new_tensor([width, height])
    slack = MARGIN * 0.5 * size
    slope = inside[..., :2] / inside[..., 2:]
    slope = torch.minimum(slope, ((size - view.middle + slack) / view.focal)[:, None])
    slope = torch.maximum(slope, (-(view.middle + slack) / view.focal)[:, None])
    scale = view.focal[:, None] / inside[..., 2:]
    # The two rows of A R: a row of R minus the slope times its last row.
    right, down = (
        scale[..., i, None] * (view.rotation[:, None, i] - slope[..., i, None] * view.rotation[:, None, 2])
        for i in range(2)
    )
    full = covariance[:, SQUARE].unflatten(1, (3, 3))
    spread_right, spread_down = (torch.einsum("kij,bkj->bki", full, row) for row in (right, down))
    xx, xy, yy = right * spread_right, right * spread_down, down * spread_down
    return torch.stack([xx.sum(2), xy.sum(2), yy.sum(2)], dim=2)
