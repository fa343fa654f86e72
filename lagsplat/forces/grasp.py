"""Grasping matter: the Gaussians under a click, how they move, and the generalised force of a force."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latent, Latents
from lagsplat.chart.chart import Chart
from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import ALPHA_MAX, ALPHA_MIN, BLUR_PX2
from lagsplat.splat.projection import View, compute_depths, project
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.decoder_mass import DecoderGeometry, compute_decoder_geometry

Point = tuple[float, float]  # x to the right and y down [px]; the first pixel's centre is (0.5, 0.5)
Size = tuple[int, int]  # height and width [px]
Place = tuple[float, float, float]  # the same in space, z away from the recording camera [px at the pivot]


class NoMatterError(ValueError):
    """No Gaussian can be grasped at a click; the message says why."""


@dataclass(frozen=True)
class GraspPoint:
    """Weights of Gaussians fixed at a click, so that the grasp follows the matter.

    ``weights`` (K,) sum to one. The Jacobian of every Gaussian is constant, and so is ``jacobian``, their
    weighted sum [px per whitened unit]. ``at`` [px] is the click, made at the state ``clicked``.

    Source: paper eq. (force).
    """

    weights: Float[Tensor, " K"]
    jacobian: Float[Tensor, "n d"]
    at: Float[Tensor, " n"]
    clicked: Latent

    def pull_back(self, force: Float[Tensor, "*B n"]) -> Float[Tensor, "*B d"]:
        """Compute the generalised force ``J^T f`` of ``force`` [energy per px]."""
        return force @ self.jacobian

    def place(self, q: Float[Tensor, "*B d"]) -> Float[Tensor, "*B n"]:
        """Position of the clicked matter at the state ``q`` [px]."""
        return self.at + (q - self.clicked) @ self.jacobian.T


@dataclass(frozen=True)
class MatterKinematics:
    """The affine map from a whitened latent to the centres of the Gaussians.

    ``center`` [px] is the position of each Gaussian at its latent centre; ``height`` and ``width`` [px] are
    those of the image. In space a pixel is a length, see `lagsplat.views.camera`.

    Source: paper, Appendix "Forces and inertia from the learned kinematics".
    """

    geometry: DecoderGeometry
    center: Float[Tensor, "K n"]
    height: int
    width: int

    @property
    def d(self) -> int:
        """Latent dimension."""
        return self.geometry.center.shape[1]

    @property
    def space(self) -> int:
        """Number of spatial dimensions: 2 in the image plane, or 3."""
        return self.center.shape[1]

    def places(self, q: Latents) -> Float[Tensor, "B K n"]:
        """Centres [px]: x to the right, y down and, in space, z away from the recording camera."""
        away = q[:, None] - self.geometry.center
        return self.center + (self.geometry.jacobian @ away[..., None])[..., 0]

    def presence(self, q: Latents) -> Float[Tensor, "B K"]:
        """Opacity of each Gaussian times its gate."""
        away = (self.geometry.precision_factor @ (q[:, None] - self.geometry.center)[..., None])[..., 0]
        return self.geometry.opacity * torch.exp(-0.5 * away.square().sum(-1))


def grasp_brush(kinematics: MatterKinematics, q: Latent, at: Point | Place, *, radius: float) -> GraspPoint:
    """Grasp what is visible around ``at`` with weights ``w_i ~ alpha_i exp(-|mu_i - x|^2 / 2 radius^2)``.

    ``alpha_i`` is opacity times gate at ``q``.

    Raises:
        NoMatterError: outside the image, or no Gaussian is visible at this state or under the brush.
        ValueError: a radius that is not positive, or a point or state that is not finite.

    Source: paper, "Interaction and Inference".
    """
    if not radius > 0.0:
        raise ValueError(f"a brush of radius {radius} px grasps nothing; give a positive one")
    present, distance = _measure_distances(kinematics, q, at)
    weights = present * torch.exp(-0.5 * distance / radius**2)
    if not float(weights.sum()) >= ALPHA_MIN:
        raise NoMatterError(
            f"nothing is present within a brush of {radius:.3g} px around {_format_point(at)}: the image "
            "shows its background colour there; click on the object or widen forces.brush"
        )
    return _make_grasp(kinematics, q, at, weights / weights.sum())


def grasp_nearest(kinematics: MatterKinematics, q: Latent, at: Point | Place) -> GraspPoint:
    """Grasp the Gaussian whose centre is closest to ``at`` among those that are visible at ``q``."""
    present, distance = _measure_distances(kinematics, q, at)
    chosen = torch.where(present >= ALPHA_MIN, distance, torch.inf).argmin()
    return _make_grasp(kinematics, q, at, torch.zeros_like(present).index_fill(0, chosen, 1.0))


def grasp_along_ray(kinematics: MatterKinematics, q: Latent, gaussian: int) -> GraspPoint:
    """Grasp the Gaussian with the number ``gaussian``, for instance of a `RayHit`, at its centre."""
    place = kinematics.places(q[None])[0, gaussian]
    weights = torch.zeros(len(kinematics.center), dtype=torch.float64)
    weights[gaussian] = 1.0
    return GraspPoint(weights, kinematics.geometry.jacobian[gaussian], place, q)


def _format_point(at: Point | Place) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in at) + ")"


def _require_inside(at: Point, height: int, width: int) -> None:
    if not (0.0 <= at[0] <= width and 0.0 <= at[1] <= height):
        raise NoMatterError(
            f"the point {_format_point(at)} is outside the image of {width} x {height} px; give x to the "
            "right and y down, in its pixels"
        )


def _measure_distances(kinematics: MatterKinematics, q: Latent, at: Point | Place) -> tuple[Tensor, Tensor]:
    """Opacity of every Gaussian at ``q``, and the square of its distance from ``at`` [px^2]."""
    place = torch.tensor(at, dtype=torch.float64)
    if len(at) != kinematics.space:
        raise ValueError(
            f"the point {_format_point(at)} has {len(at)} coordinates and the Gaussians have "
            f"{kinematics.space} dimensions; in space, cast a ray through the pixel first (`cast_ray`)"
        )
    if not bool(torch.isfinite(place).all() and torch.isfinite(q).all()):
        raise ValueError(f"the click {at} or the state {q.tolist()} is not finite; check the rollout")
    if len(at) == 2:
        _require_inside(at, kinematics.height, kinematics.width)
    present = kinematics.presence(q[None])[0]
    if not float(present.max()) >= ALPHA_MIN:
        raise NoMatterError(
            f"no Gaussian is present at the state {[round(x, 3) for x in q.tolist()]}: it lies outside what "
            "the recording showed, and nothing is drawn there; go back towards the visited range"
        )
    return present, (kinematics.places(q[None])[0] - place).square().sum(1)


def _make_grasp(kinematics: MatterKinematics, q: Tensor, at: Point | Place, weights: Tensor) -> GraspPoint:
    jacobian = torch.einsum("k,kcd->cd", weights, kinematics.geometry.jacobian)
    return GraspPoint(weights, jacobian, torch.tensor(at, dtype=torch.float64), q)


def compute_kinematics(autoencoder: Autoencoder, chart: Chart) -> MatterKinematics:
    """The kinematics of a decoder in the whitened coordinates of a chart (float64)."""
    center = autoencoder.gaussians.center.detach().cpu().double()
    geometry = compute_decoder_geometry(autoencoder, chart)
    return MatterKinematics(geometry, center, autoencoder.height, autoencoder.width)


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
    _require_inside(pixel, height, width)
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
            f"the ray through {_format_point(pixel)} meets nothing: its opacity is only {opacity:.0%}; click "
            "on the object"
        )
    first = int(hit.double().argmax())
    number, depth, _ = flat.color[0, first].tolist()
    return RayHit(int(number), depth, 1.0 - float(transmittance[first]))


def evaluate_alpha(flat: GaussianSlice, pixel: Point) -> Float[Tensor, " K"]:
    """Evaluate the alpha of each planar Gaussian in a pixel, as `lagsplat.splat.image_model` does."""
    xx, xy, yy = (flat.covariance[0].double() + torch.tensor([BLUR_PX2, 0.0, BLUR_PX2])).unbind(1)
    dx, dy = (torch.tensor(pixel) - flat.means[0].double()).unbind(1)
    sigma = 0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    alpha = (flat.opacity[0].double() * torch.exp(-sigma)).clamp(max=ALPHA_MAX)
    return torch.where(alpha >= ALPHA_MIN, alpha, 0.0)
