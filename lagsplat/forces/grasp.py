"""Grasping matter: what is under a click, how it moves, and the generalised force of a force on it."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lagsplat.array_types import Latent
from lagsplat.matter.field import MaterialPoints, MatterField

Point = tuple[float, float]  # x to the right and y down [px]; the first pixel's centre is (0.5, 0.5)
Place = tuple[float, float, float]  # the same in space, z away from the recording camera [px at the pivot]


class NoMatterError(ValueError):
    """Nothing can be grasped at a click; the message says why."""


@dataclass(frozen=True)
class GraspPoint:
    """Matter that is held at a point.

    Args:
        points: one point, which follows the matter around the click.
        at: the click [px], made at the state ``clicked``.
        clicked: that state.
        is_background: no matter was there: what is held never moves.

    Source: paper eq. (force).
    """

    points: MaterialPoints
    at: Float[Tensor, " n"]
    clicked: Latent
    is_background: bool

    def jacobian(self, q: Latent) -> Float[Tensor, "n d"]:
        """Motion of the held matter per whitened unit at a state [px]."""
        return self.points.jacobian(q)[0]

    def pull_back(self, force: Float[Tensor, "*B n"], q: Latent) -> Float[Tensor, "*B d"]:
        """Compute the generalised force ``J(q)^T f`` of ``force`` [energy per px]."""
        return force @ self.jacobian(q)

    def place(self, q: Latent) -> Float[Tensor, " n"]:
        """Position of the held matter at a state [px]."""
        return self.points.carry(q[None])[0, 0]


SPACING_PX = 1.0  # of material points: no place inside a body is farther from one
LEAST_SPREAD_PX2 = 1e-3  # variance of points across a line or a plane, on which a mean cannot be moved


def grasp_brush(
    matter: MatterField, q: Latent, at: Point | Place, *, radius: float, size: tuple[int, int] | None = None
) -> GraspPoint:
    """Grasp the matter under a brush, or the background, which does not move, where there is none.

    Args:
        matter: of the run.
        q: state of the click.
        at: the click [px].
        radius: of the brush [px].
        size: height and width of the image [px], to refuse points outside it.

    Raises:
        NoMatterError: outside the image.
        ValueError: a radius that is not positive, or a point or state that is not finite.

    Source: paper, "Interaction and Inference"; the points are of matter, not the drawn Gaussians.
    """
    if not radius > 0.0:
        raise ValueError(f"a brush of radius {radius} px grasps nothing; give a positive one")
    if len(at) != matter.space:
        raise ValueError(
            f"the point {format_point(at)} has {len(at)} coordinates and matter has {matter.space} "
            "dimensions; in space, cast a ray through the pixel first (`cast_ray`)"
        )
    place = torch.tensor(at, dtype=torch.float64)
    if not bool(torch.isfinite(place).all() and torch.isfinite(q).all()):
        raise ValueError(f"the click {at} or the state {q.tolist()} is not finite; check the rollout")
    if len(at) == 2 and size is not None:
        require_inside(at, *size)
    points, on_matter = follow_places(matter, q, place[None], radius=radius)
    return GraspPoint(points, place, q, not bool(on_matter[0]))


def follow_places(
    matter: MatterField, q: Latent, places: Float[Tensor, "N n"], *, radius: float
) -> tuple[MaterialPoints, Bool[Tensor, " N"]]:
    """The matter that is at some places in a state, and where there is any; elsewhere is background.

    A place belongs to the body of the nearest material point, if that is within ``radius`` [px] or a pixel.
    The points ``x_i`` of that body have the weights ``k_i (a + b.(x_i - place))`` with the brush ``k_i =
    exp(-|x_i - place|^2 / 2 radius^2)``; ``a`` and ``b`` make their sum one and their mean the place, so that
    a brush at an edge holds the edge and not what is further inside.

    Source: Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, section 6.1.1, local linear
    regression.
    """
    away = matter.carry(q[None])[0] - places[:, None]
    square = away.square().sum(2)
    least, nearest = square.min(1, keepdim=True)
    brush = torch.exp(-0.5 * (square - least) / radius**2)
    brush = brush.where(matter.body == matter.body[nearest], 0.0)
    brush = brush / brush.sum(1, keepdim=True)
    mean = torch.einsum("np,npi->ni", brush, away)
    spread = torch.einsum("np,npi,npj->nij", brush, away, away)
    spread = spread + LEAST_SPREAD_PX2 * torch.eye(matter.space, dtype=spread.dtype)
    tilt = torch.linalg.solve(spread, mean)
    weights = brush * (1.0 - torch.einsum("ni,npi->np", tilt, away))
    on_matter = least <= max(radius, SPACING_PX) ** 2
    weights = (weights / weights.sum(1, keepdim=True)).where(on_matter, 0.0)
    return matter.average(weights).passing(places, q), on_matter[:, 0]


def format_point(at: Point | Place) -> str:
    """A point for a message."""
    return "(" + ", ".join(f"{x:.4g}" for x in at) + ")"


def require_inside(at: Point, height: int, width: int) -> None:
    """Raise a `NoMatterError` unless a point is in an image."""
    if not (0.0 <= at[0] <= width and 0.0 <= at[1] <= height):
        raise NoMatterError(
            f"the point {format_point(at)} is outside the image of {width} x {height} px; give x to the "
            "right and y down, in its pixels"
        )
