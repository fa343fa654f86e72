"""A click in a picture of space: the ray through a pixel, and what it meets first."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.chart.chart import Chart
from lagsplat.forces.grip import NothingThereError, Point
from lagsplat.splat.gaussians import Slice
from lagsplat.splat.image_model import ALPHA_MAX, ALPHA_MIN, BLUR_PX2
from lagsplat.splat.projection import View, depths, project
from lagsplat.stage1.autoencoder import Autoencoder

STOPPED = 0.5
"""Of the light: the Gaussian at which less of it than this is left is the one that the pixel shows."""


@dataclass(frozen=True)
class Hit:
    """The first Gaussian that a ray meets: its number, how far ahead of the camera its centre is [px at the
    pivot], and the share of the light that is stopped up to and with it.
    """

    gaussian: int
    depth: float
    cover: float


@torch.no_grad()
def cast(
    autoencoder: Autoencoder,
    chart: Chart,
    q: Float[Tensor, " d"],
    view: View,
    pixel: Point,
    *,
    size: tuple[int, int] | None = None,
) -> Hit:
    """What the camera ``view`` shows in ``pixel`` at the whitened state ``q``.

    ``size`` is the height and width of its pictures [px], those of the training ones unless told otherwise.

    Gaussians are gone through from near to far as the picture is composited, with the alpha that each has in
    the pixel; the ray has met one when half of its light is stopped. So what is met is what is seen.

    Raises:
        NothingThereError: the pixel is outside the picture, or all that lies on the ray stops less than half.
        ValueError: the Gaussians live in the picture, or the state is not finite.

    Source: paper, "Forces in three dimensions".
    """
    model = autoencoder.gaussians
    if model.space != 3:
        raise ValueError(
            "these Gaussians live in the picture: take hold of them with a brush, not with a ray"
        )
    if not bool(torch.isfinite(q).all()):
        raise ValueError(f"the state {q.tolist()} is not finite; check the rollout")
    height, width = size or (autoencoder.height, autoencoder.width)
    if not (0.0 <= pixel[0] <= width and 0.0 <= pixel[1] <= height):
        raise NothingThereError(
            f"the point ({pixel[0]:.4g}, {pixel[1]:.4g}) is outside the picture of {width} x {height} px; "
            "give x to the right and y down, in its pixels"
        )
    scene = model.condition(torch.from_numpy(chart.to_raw(q[None].numpy())).to(model.center))
    ahead = depths(scene.means, view)
    # What is known of each Gaussian goes along in place of its colour.
    told = torch.stack([torch.arange(model.n).expand_as(ahead), ahead, torch.zeros_like(ahead)], dim=2)
    flat = project(scene._replace(color=told.to(ahead)), view, height=height, width=width)
    left = torch.cumprod(1.0 - alpha_at(flat, pixel), dim=0)
    met = left < STOPPED
    if not bool(met.any()):
        raise NothingThereError(
            f"the ray through ({pixel[0]:.4g}, {pixel[1]:.4g}) meets nothing: all that lies on it stops "
            f"{1.0 - float(left.min()) if len(left) else 0.0:.0%} of the light; click on the object"
        )
    first = int(met.double().argmax())
    number, depth, _ = flat.color[0, first].tolist()
    return Hit(int(number), depth, 1.0 - float(left[first]))


def alpha_at(flat: Slice, pixel: Point) -> Float[Tensor, " K"]:
    """Alpha of each planar Gaussian of one image in a point, as `lagsplat.splat.image_model` has it."""
    xx, xy, yy = (flat.covariance[0].double() + torch.tensor([BLUR_PX2, 0.0, BLUR_PX2])).unbind(1)
    dx, dy = (torch.tensor(pixel) - flat.means[0].double()).unbind(1)
    sigma = 0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    alpha = (flat.opacity[0].double() * torch.exp(-sigma)).clamp(max=ALPHA_MAX)
    return torch.where(alpha >= ALPHA_MIN, alpha, 0.0)
