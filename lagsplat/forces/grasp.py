"""What a click takes hold of, and the pull-back of a force on it.

Where the decoder's Gaussians are and how they move, in whitened latents.

A click in a picture of space: the ray through a pixel, and what it meets first.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latents
from lagsplat.chart.chart import Chart
from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import ALPHA_MAX, ALPHA_MIN, BLUR_PX2
from lagsplat.splat.projection import View, compute_depths, project
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.decoder_mass import DecoderGeometry, compute_decoder_geometry

Point = tuple[float, float]
"""x to the right and y down [px]; the first pixel's centre is (0.5, 0.5)."""
Place = tuple[float, float, float]
"""The same in space, with z ahead of the film's camera [px at the pivot]."""


class NoMatterError(ValueError):
    """A click on which no Gaussian can be taken hold of; the message says why."""


@dataclass(frozen=True)
class GraspPoint:
    """A choice of Gaussians, frozen at the click; it follows the matter and not the picture.

    ``weights`` (K,) sum to one. Since every Gaussian's Jacobian is constant, so is ``jacobian``, their
    weighted sum [px per whitened unit]: a force costs ``n d`` products a step, whatever the state.
    ``at`` [px] is the click, made at the state ``clicked``.

    Source: paper eq. (force).
    """

    weights: Float[Tensor, " K"]
    jacobian: Float[Tensor, "n d"]
    at: Float[Tensor, " n"]
    clicked: Float[Tensor, " d"]

    def pull_back(self, force: Float[Tensor, "*B n"]) -> Float[Tensor, "*B d"]:
        """``J^T f``: the generalised force that does the work of ``force`` [energy per px]."""
        return force @ self.jacobian

    def place(self, q: Float[Tensor, "*B d"]) -> Float[Tensor, "*B n"]:
        """Where the clicked matter is at the state ``q`` [px]."""
        return self.at + (q - self.clicked) @ self.jacobian.T


@dataclass(frozen=True)
class MatterKinematics:
    """The map from a whitened latent to the centre of each Gaussian, affine and hence of constant Jacobian.

    ``center`` [px] is where a Gaussian stands at its own latent centre, ``geometry`` holds its Jacobian and
    its gate; ``height`` and ``width`` [px] are those of the picture. In space a pixel is a length, see
    `lagsplat.views.camera`.

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
        """Number of spatial dimensions: 2 in the picture, or 3."""
        return self.center.shape[1]

    def places(self, q: Latents) -> Float[Tensor, "B K n"]:
        """Centres [px], x to the right, y down and, in space, z ahead of the film's camera."""
        away = q[:, None] - self.geometry.center
        return self.center + (self.geometry.jacobian @ away[..., None])[..., 0]

    def presence(self, q: Latents) -> Float[Tensor, "B K"]:
        """Opacity of each Gaussian once its gate is counted."""
        away = (self.geometry.precision_factor @ (q[:, None] - self.geometry.center)[..., None])[..., 0]
        return self.geometry.opacity * torch.exp(-0.5 * away.square().sum(-1))


def grasp_brush(
    kinematics: MatterKinematics,
    q: Float[Tensor, " d"],
    at: Point | Place,
    *,
    radius: float,
    least: float = ALPHA_MIN,
) -> GraspPoint:
    """Take hold of what is present around ``at``: weights ``w_i ~ alpha_i exp(-|mu_i - x|^2 / 2 radius^2)``.

    ``alpha_i`` is the opacity at the state ``q``, its gate counted: what cannot be seen is not clicked on.
    ``radius`` [px]; less than ``least`` of opacity under the brush counts as nothing.

    Raises:
        NothingThereError: the point is outside the picture, no Gaussian is present at this state, or none
            under the brush.
        ValueError: a radius that is not positive, or a point or state that is not finite.

    Source: paper, "Interaction and Inference".
    """
    if not radius > 0.0:
        raise ValueError(f"a brush of radius {radius} px takes hold of nothing; give a positive one")
    present, distance = _around(kinematics, q, at)
    weights = present * torch.exp(-0.5 * distance / radius**2)
    if not float(weights.sum()) >= least:
        raise NoMatterError(
            f"nothing is present within a brush of {radius:.3g} px around {_told(at)}: the picture shows its "
            "background colour there; click on the object or widen forces.brush"
        )
    return _grip(kinematics, q, at, weights / weights.sum())


def nearest_place(
    kinematics: MatterKinematics, q: Float[Tensor, " d"], at: Point | Place, *, least: float = ALPHA_MIN
) -> GraspPoint:
    """Take hold of the one Gaussian whose centre is closest to ``at`` among those that are drawn at ``q``.

    Raises:
        NothingThereError, ValueError: as `grasp_brush`.
    """
    present, distance = _around(kinematics, q, at)
    chosen = torch.where(present >= least, distance, torch.inf).argmin()
    return _grip(kinematics, q, at, torch.zeros_like(present).index_fill(0, chosen, 1.0))


def grasp_along_ray(kinematics: MatterKinematics, q: Float[Tensor, " d"], gaussian: int) -> GraspPoint:
    """Take hold of one Gaussian, at its centre."""
    place = kinematics.places(q[None])[0, gaussian]
    weights = torch.zeros(len(kinematics.center), dtype=torch.float64).index_fill(
        0, torch.tensor(gaussian), 1.0
    )
    return GraspPoint(weights, kinematics.geometry.jacobian[gaussian], place, q)


def _told(at: Point | Place) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in at) + ")"


def _around(kinematics: MatterKinematics, q: Float[Tensor, " d"], at: Point | Place) -> tuple[Tensor, Tensor]:
    """Opacity of every Gaussian at ``q``, and the square of its distance from ``at`` [px^2]."""
    place = torch.tensor(at, dtype=torch.float64)
    if len(at) != kinematics.space:
        raise ValueError(
            f"the point {_told(at)} has {len(at)} coordinates and the Gaussians live in {kinematics.space} "
            "dimensions; in space, cast a ray through the pixel first (`lagsplat.forces.grasp.cast_ray`)"
        )
    if not bool(torch.isfinite(place).all() and torch.isfinite(q).all()):
        raise ValueError(f"the click {at} or the state {q.tolist()} is not finite; check the rollout")
    if len(at) == 2 and not (0.0 <= at[0] <= kinematics.width and 0.0 <= at[1] <= kinematics.height):
        raise NoMatterError(
            f"the point {_told(at)} is outside the picture of {kinematics.width} x "
            f"{kinematics.height} px; give x to the right and y down, in pixels of the training resolution"
        )
    present = kinematics.presence(q[None])[0]
    if not float(present.max()) >= ALPHA_MIN:
        raise NoMatterError(
            f"no Gaussian is present at the state {[round(x, 3) for x in q.tolist()]}: it lies outside what "
            "the recording showed, and nothing is drawn there; go back towards the visited range"
        )
    return present, (kinematics.places(q[None])[0] - place).square().sum(1)


def _grip(kinematics: MatterKinematics, q: Tensor, at: Point | Place, weights: Tensor) -> GraspPoint:
    jacobian = torch.einsum("k,kcd->cd", weights, kinematics.geometry.jacobian)
    return GraspPoint(weights, jacobian, torch.tensor(at, dtype=torch.float64), q)


def compute_kinematics(autoencoder: Autoencoder, chart: Chart) -> MatterKinematics:
    """The kinematics of a decoder in the whitened coordinates of a chart (float64)."""
    return MatterKinematics(
        geometry=compute_decoder_geometry(autoencoder, chart),
        center=autoencoder.gaussians.center.detach().cpu().double(),
        height=autoencoder.height,
        width=autoencoder.width,
    )


STOPPED = 0.5
"""Of the light: the Gaussian at which less of it than this is left is the one that the pixel shows."""


@dataclass(frozen=True)
class RayHit:
    """The first Gaussian that a ray meets: its number, how far ahead of the camera its centre is [px at the
    pivot], and the share of the light that is stopped up to and with it.
    """

    gaussian: int
    depth: float
    cover: float


@torch.no_grad()
def cast_ray(
    autoencoder: Autoencoder,
    chart: Chart,
    q: Float[Tensor, " d"],
    view: View,
    pixel: Point,
    *,
    size: tuple[int, int] | None = None,
) -> RayHit:
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
        raise NoMatterError(
            f"the point ({pixel[0]:.4g}, {pixel[1]:.4g}) is outside the picture of {width} x {height} px; "
            "give x to the right and y down, in its pixels"
        )
    scene = model.condition(torch.from_numpy(chart.to_raw(q[None].numpy())).to(model.center))
    ahead = compute_depths(scene.means, view)
    # What is known of each Gaussian goes along in place of its colour.
    told = torch.stack([torch.arange(model.n).expand_as(ahead), ahead, torch.zeros_like(ahead)], dim=2)
    flat = project(scene._replace(color=told.to(ahead)), view, height=height, width=width)
    left = torch.cumprod(1.0 - alpha_at(flat, pixel), dim=0)
    met = left < STOPPED
    if not bool(met.any()):
        raise NoMatterError(
            f"the ray through ({pixel[0]:.4g}, {pixel[1]:.4g}) meets nothing: all that lies on it stops "
            f"{1.0 - float(left.min()) if len(left) else 0.0:.0%} of the light; click on the object"
        )
    first = int(met.double().argmax())
    number, depth, _ = flat.color[0, first].tolist()
    return RayHit(int(number), depth, 1.0 - float(left[first]))


def alpha_at(flat: GaussianSlice, pixel: Point) -> Float[Tensor, " K"]:
    """Alpha of each planar Gaussian of one image in a point, as `lagsplat.splat.image_model` has it."""
    xx, xy, yy = (flat.covariance[0].double() + torch.tensor([BLUR_PX2, 0.0, BLUR_PX2])).unbind(1)
    dx, dy = (torch.tensor(pixel) - flat.means[0].double()).unbind(1)
    sigma = 0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    alpha = (flat.opacity[0].double() * torch.exp(-sigma)).clamp(max=ALPHA_MAX)
    return torch.where(alpha >= ALPHA_MIN, alpha, 0.0)
