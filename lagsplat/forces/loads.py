"""Loads on a law: constant generalised forces, and forces on points of matter, which follow its ways."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latents
from lagsplat.matter.body_motion import BodyMotion
from lagsplat.matter.field import MaterialPoints


@runtime_checkable
class Load(Protocol):
    """Forces on states, one row each; one row alone acts on every state."""

    def __len__(self) -> int:
        """Number of rows."""

    def work(self, q: Latents) -> Float[Tensor, " B"]:
        """Work from any fixed state to ``q`` [energy of the law]."""

    def generalise(self, q: Latents) -> Latents:
        """Generalised force [energy per whitened unit], the slope of `work`."""

    def moved_by(self, bodies: tuple[BodyMotion, ...]) -> "Load":
        """The same forces on matter of bodies that move otherwise."""


@dataclass(frozen=True)
class ConstantLoad:
    """A generalised force ``value`` (B, d) that does not depend on the state [energy per whitened unit].

    Raises:
        ValueError: it is not finite.
    """

    value: Latents

    def __post_init__(self) -> None:
        _require_finite(self.value)

    def __len__(self) -> int:
        return len(self.value)

    def work(self, q: Latents) -> Float[Tensor, " B"]:
        """Work from the mean state to ``q`` [energy of the law]."""
        return (q * self.value).sum(1)

    def generalise(self, q: Latents) -> Latents:
        """The generalised force, at every state the same."""
        return self.value.expand_as(q)

    def moved_by(self, bodies: tuple[BodyMotion, ...]) -> "ConstantLoad":
        """The same load, which is on no matter."""
        return self


@dataclass(frozen=True)
class PointLoad:
    """Forces on points of matter, of constant size and direction.

    Args:
        points: one for each row, or one for all.
        force: to the right, down and, in space, ahead [energy of the law per px], one for each row or for
            all.

    Raises:
        ValueError: a force is not finite.

    Source: paper eq. (force), ``J(q)^T f``.
    """

    points: MaterialPoints
    force: Float[Tensor, "B n"]

    def __post_init__(self) -> None:
        _require_finite(self.force)

    def __len__(self) -> int:
        return max(len(self.points), len(self.force))

    def work(self, q: Latents) -> Float[Tensor, " B"]:
        """Work along the ways of the points from the mean state to ``q`` [energy of the law]."""
        return ((self.points.carry_each(q) - self.points.at) * self.force).sum(1)

    def generalise(self, q: Latents) -> Latents:
        """``J(q)^T f`` [energy per whitened unit]."""
        return torch.einsum("bnd,bn->bd", self.points.differentiate_each(q), self.force)

    def moved_by(self, bodies: tuple[BodyMotion, ...]) -> "PointLoad":
        """The same forces on the same points of bodies that move otherwise."""
        return PointLoad(self.points.moved_by(bodies), self.force)


@dataclass(frozen=True)
class SummedLoad:
    """Several loads at once."""

    parts: tuple[Load, ...]

    def __len__(self) -> int:
        return max(len(part) for part in self.parts)

    def work(self, q: Latents) -> Float[Tensor, " B"]:
        """Sum of their works."""
        return torch.stack([part.work(q) for part in self.parts]).sum(0)

    def generalise(self, q: Latents) -> Latents:
        """Sum of their generalised forces."""
        return torch.stack([part.generalise(q) for part in self.parts]).sum(0)

    def moved_by(self, bodies: tuple[BodyMotion, ...]) -> "SummedLoad":
        """The same loads on bodies that move otherwise."""
        return SummedLoad(tuple(part.moved_by(bodies) for part in self.parts))


@dataclass(frozen=True)
class ScaledLoad:
    """A load times a factor."""

    load: Load
    factor: float

    def __len__(self) -> int:
        return len(self.load)

    def work(self, q: Latents) -> Float[Tensor, " B"]:
        """Its work, scaled."""
        return self.factor * self.load.work(q)

    def generalise(self, q: Latents) -> Latents:
        """Its generalised force, scaled."""
        return self.factor * self.load.generalise(q)

    def moved_by(self, bodies: tuple[BodyMotion, ...]) -> "ScaledLoad":
        """The same load on bodies that move otherwise, scaled."""
        return ScaledLoad(self.load.moved_by(bodies), self.factor)


def make_no_load(d: int) -> ConstantLoad:
    """No force on ``d`` coordinates."""
    return ConstantLoad(torch.zeros(1, d, dtype=torch.float64))


def _require_finite(force: Tensor) -> None:
    if not bool(torch.isfinite(force).all()):
        raise ValueError("a force is not finite: give finite numbers, in pixels and energy per pixel")
