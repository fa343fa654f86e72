"""Rays from a camera: the first Gaussian in space that a pixel shows."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latent
from lagsplat.chart.chart import Chart
from lagsplat.forces.grasp import SPACING_PX, NoMatterError, Place, Point, format_point, require_inside
from lagsplat.matter.field import MatterField
from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import ALPHA_MAX, ALPHA_MIN, BLUR_PX2
from lagsplat.splat.projection import View, compute_depths, project
from lagsplat.stage1.autoencoder import Autoencoder

Size = tuple[int, int]  # height and width [px]
BEHIND = 0.05  # share of the depth of a Gaussian by which it may be too near, set by hand
STOPPED = 0.5  # transmittance below which a ray has hit the Gaussian that the pixel shows


@dataclass(frozen=True)
class RayHit:
    """The first Gaussian that a ray hits.

    ``gaussian`` is its number, ``depth`` the distance of its centre ahead of the camera [px at the pivot],
    ``cover`` the opacity of the ray up to and including it.
    """

    gaussian: int
    depth: float
    cover: float


@torch.no_grad()
def cast_ray(
    autoencoder: Autoencoder, chart: Chart, q: Latent, view: View, pixel: Point, *, size: Size | None = None
) -> RayHit:
    """Find the Gaussian that the camera ``view`` shows in ``pixel`` at the whitened state ``q``.

    The ray passes the Gaussians from near to far with the alpha that each has in the pixel, as in
    compositing, and hits the one at which half of its light is absorbed. ``size`` is the image's height and
    width [px], by default those of training.

    Raises:
        NoMatterError: the pixel is outside the image, or the ray is absorbed by less than half.
        ValueError: the Gaussians are not in space, or the state is not finite.

    Source: paper, "Forces in three dimensions".
    """
    model = autoencoder.gaussians
    if model.space != 3:
        raise ValueError("these Gaussians are in the image plane: grasp them with a brush, not with a ray")
    if not bool(torch.isfinite(q).all()):
        raise ValueError(f"the state {q.tolist()} is not finite; check the rollout")
    height, width = size or (autoencoder.height, autoencoder.width)
    require_inside(pixel, height, width)
    scene = model.condition(torch.from_numpy(chart.to_raw(q[None].numpy())).to(model.center))
    ahead = compute_depths(scene.means, view)
    # number and depth of each Gaussian are sorted with it in place of its colour
    labels = torch.stack([torch.arange(model.n).expand_as(ahead), ahead, torch.zeros_like(ahead)], dim=2)
    flat = project(scene._replace(color=labels.to(ahead)), view, height=height, width=width)
    transmittance = torch.cumprod(1.0 - evaluate_alpha(flat, pixel), dim=0)
    hit = transmittance < STOPPED
    if not bool(hit.any()):
        opacity = 1.0 - float(transmittance.min()) if len(transmittance) else 0.0
        raise NoMatterError(
            f"the ray through {format_point(pixel)} meets nothing: its opacity is only {opacity:.0%}; click "
            "on the object"
        )
    first = int(hit.double().argmax())
    number, depth, _ = flat.color[0, first].tolist()
    return RayHit(int(number), depth, 1.0 - float(transmittance[first]))


def find_matter_depth(matter: MatterField, q: Latent, view: View, pixel: Point, hit: RayHit) -> float:
    """Depth at which a ray touches matter; that of the Gaussian which it hits where no matter is in its way.

    The depth of a Gaussian is not exact, so matter up to `BEHIND` farther than it counts as hit; what is
    farther is hidden by it.

    Args:
        matter: of the run.
        q: the state.
        view: one camera.
        pixel: through which the ray goes.
        hit: from `cast_ray`.
    """
    rotation, shift, focal, middle = (part[0].double() for part in view)
    inside = matter.carry(q[None])[0] @ rotation.T + shift
    depth = inside[:, 2]
    ahead = (torch.tensor(pixel, dtype=torch.float64) - middle) / focal
    aside = (inside[:, :2] - depth[:, None] * ahead).norm(dim=1)
    touched = (aside <= SPACING_PX) & (depth > 0.0) & (depth <= (1.0 + BEHIND) * hit.depth)
    return float(depth[touched].min()) if bool(touched.any()) else hit.depth


def place_on_ray(view: View, pixel: Point, depth: float) -> Place:
    """The point of a ray at a depth [px at the pivot]."""
    at, deep = (torch.tensor([each]).to(view.focal) for each in (pixel, depth))
    x, y, z = view.unproject(at, deep)[0].tolist()
    return x, y, z


def evaluate_alpha(flat: GaussianSlice, pixel: Point) -> Float[Tensor, " K"]:
    """Evaluate the alpha of each planar Gaussian in a pixel, as `lagsplat.splat.image_model` does."""
    xx, xy, yy = (flat.covariance[0].double() + torch.tensor([BLUR_PX2, 0.0, BLUR_PX2])).unbind(1)
    dx, dy = (torch.tensor(pixel) - flat.means[0].double()).unbind(1)
    sigma = 0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    alpha = (flat.opacity[0].double() * torch.exp(-sigma)).clamp(max=ALPHA_MAX)
    return torch.where(alpha >= ALPHA_MIN, alpha, 0.0)
