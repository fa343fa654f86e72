"""What a click takes hold of, and the pull-back of a force on it."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.forces.kinematics import Kinematics
from lagsplat.splat.image_model import ALPHA_MIN

Point = tuple[float, float]
"""x to the right and y down [px]; the first pixel's centre is (0.5, 0.5)."""
Place = tuple[float, float, float]
"""The same in space, with z ahead of the film's camera [px at the pivot]."""


class NothingThereError(ValueError):
    """A click on which no Gaussian can be taken hold of; the message says why."""


@dataclass(frozen=True)
class Grip:
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


def brush(
    kinematics: Kinematics,
    q: Float[Tensor, " d"],
    at: Point | Place,
    *,
    radius: float,
    least: float = ALPHA_MIN,
) -> Grip:
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
        raise NothingThereError(
            f"nothing is present within a brush of {radius:.3g} px around {_told(at)}: the picture shows its "
            "background colour there; click on the object or widen forces.brush"
        )
    return _grip(kinematics, q, at, weights / weights.sum())


def nearest(
    kinematics: Kinematics, q: Float[Tensor, " d"], at: Point | Place, *, least: float = ALPHA_MIN
) -> Grip:
    """Take hold of the one Gaussian whose centre is closest to ``at`` among those that are drawn at ``q``.

    Raises:
        NothingThereError, ValueError: as `brush`.
    """
    present, distance = _around(kinematics, q, at)
    chosen = torch.where(present >= least, distance, torch.inf).argmin()
    return _grip(kinematics, q, at, torch.zeros_like(present).index_fill(0, chosen, 1.0))


def hold_of(kinematics: Kinematics, q: Float[Tensor, " d"], gaussian: int) -> Grip:
    """Take hold of one Gaussian, at its centre."""
    place = kinematics.places(q[None])[0, gaussian]
    weights = torch.zeros(len(kinematics.center), dtype=torch.float64).index_fill(
        0, torch.tensor(gaussian), 1.0
    )
    return Grip(weights, kinematics.geometry.jacobian[gaussian], place, q)


def _told(at: Point | Place) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in at) + ")"


def _around(kinematics: Kinematics, q: Float[Tensor, " d"], at: Point | Place) -> tuple[Tensor, Tensor]:
    """Opacity of every Gaussian at ``q``, and the square of its distance from ``at`` [px^2]."""
    place = torch.tensor(at, dtype=torch.float64)
    if len(at) != kinematics.space:
        raise ValueError(
            f"the point {_told(at)} has {len(at)} coordinates and the Gaussians live in {kinematics.space} "
            "dimensions; in space, cast a ray through the pixel first (`lagsplat.forces.ray.cast`)"
        )
    if not bool(torch.isfinite(place).all() and torch.isfinite(q).all()):
        raise ValueError(f"the click {at} or the state {q.tolist()} is not finite; check the rollout")
    if len(at) == 2 and not (0.0 <= at[0] <= kinematics.width and 0.0 <= at[1] <= kinematics.height):
        raise NothingThereError(
            f"the point {_told(at)} is outside the picture of {kinematics.width} x "
            f"{kinematics.height} px; give x to the right and y down, in pixels of the training resolution"
        )
    present = kinematics.presence(q[None])[0]
    if not float(present.max()) >= ALPHA_MIN:
        raise NothingThereError(
            f"no Gaussian is present at the state {[round(x, 3) for x in q.tolist()]}: it lies outside what "
            "the recording showed, and nothing is drawn there; go back towards the visited range"
        )
    return present, (kinematics.places(q[None])[0] - place).square().sum(1)


def _grip(kinematics: Kinematics, q: Tensor, at: Point | Place, weights: Tensor) -> Grip:
    jacobian = torch.einsum("k,kcd->cd", weights, kinematics.geometry.jacobian)
    return Grip(weights, jacobian, torch.tensor(at, dtype=torch.float64), q)
