"""The matter of a film: material points, the body each belongs to, and how the bodies move with the state."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from lagsplat.array_types import Latent, Latents
from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.matter.body_motion import BodyMotion, Points

KIND = "matter"
SCHEMA = 1
# Set by hand, with the simulated rocker, pendulum and two-segment arm in view.
LEAST_EXPLAINED = 0.5  # of the loss of a still picture that the motion of a body saves
MOST_UNEXPLAINED = 0.1  # of the moving pixels that belong to no body


@dataclass(frozen=True)
class MaterialPoints:
    """``N`` points of matter, each a weighted mean of material points; what no body moves stays.

    Args:
        at: places at the mean state, where all latents are zero [px].
        bodies: how each body moves.
        bases: for each body, the weighted means of its basis (`BodyMotion.evaluate_basis`), zero for points
            of other bodies.
    """

    at: Float[Tensor, "N n"]
    bodies: tuple[BodyMotion, ...]
    bases: tuple[Float[Tensor, "N m"], ...]

    def __len__(self) -> int:
        return len(self.at)

    def __getitem__(self, rows: slice | Int[Tensor, " M"]) -> "MaterialPoints":
        return MaterialPoints(self.at[rows], self.bodies, tuple(basis[rows] for basis in self.bases))

    def carry(self, q: Latents) -> Float[Tensor, "B N n"]:
        """Places of all points at each state [px]."""
        ways = [basis @ body.displace(q).mT for body, basis in zip(self.bodies, self.bases, strict=True)]
        return self.at + torch.stack(ways).sum(0)

    def carry_each(self, q: Float[Tensor, "N d"]) -> Float[Tensor, "N n"]:
        """Place of each point at a state of its own [px]."""
        pairs = zip(self.bodies, self.bases, strict=True)
        ways = [torch.einsum("bnm,bm->bn", body.displace(q), basis) for body, basis in pairs]
        return self.at + torch.stack(ways).sum(0)

    def differentiate_each(self, q: Float[Tensor, "N d"]) -> Float[Tensor, "N n d"]:
        """Motion of each point per whitened unit, at a state of its own [px]."""
        pairs = zip(self.bodies, self.bases, strict=True)
        return torch.stack(
            [torch.einsum("bnmd,bm->bnd", body.differentiate(q), basis) for body, basis in pairs]
        ).sum(0)

    def jacobian(self, q: Latent) -> Float[Tensor, "N n d"]:
        """Motion of all points per whitened unit at one state [px]."""
        pairs = zip(self.bodies, self.bases, strict=True)
        slopes = [torch.einsum("nmd,pm->pnd", body.differentiate(q[None])[0], basis) for body, basis in pairs]
        return torch.stack(slopes).sum(0)

    def moved_by(self, bodies: tuple[BodyMotion, ...]) -> "MaterialPoints":
        """The same points of bodies that move otherwise."""
        return replace(self, bodies=bodies)

    def passing(self, places: Float[Tensor, "N n"], q: Latent) -> "MaterialPoints":
        """The points of the same bodies that are at ``places`` [px] in the state ``q``, if these are near."""
        return replace(self, at=self.at + places - self.carry(q[None])[0])


def join_points(parts: Sequence[MaterialPoints]) -> MaterialPoints:
    """Points of one field in one batch, in their order."""
    bases = zip(*(part.bases for part in parts), strict=True)
    return MaterialPoints(
        torch.cat([part.at for part in parts]), parts[0].bodies, tuple(torch.cat(each) for each in bases)
    )


@dataclass(frozen=True)
class MatterField:
    """Material points of bodies; the background has none.

    Args:
        bodies: how each body moves.
        points: places of the material points at the mean state, where all latents are zero [px]; each stands
            for one pixel of the picture there.
        body: number of the body of each point.

    Example:
        >>> import torch
        >>> from lagsplat.matter.body_motion import make_body_at_rest
        >>> from lagsplat.monomials import make_wide_ball
        >>> points = torch.tensor([[1.0, 2.0], [3.0, 4.0]]).double()
        >>> body = make_body_at_rest(points, make_wide_ball(1), bending=0)
        >>> field = MatterField((body,), points, torch.zeros(2).long())
        >>> field.carry(torch.zeros(1, 1).double()).tolist()
        [[[1.0, 2.0], [3.0, 4.0]]]
    """

    bodies: tuple[BodyMotion, ...]
    points: Points
    body: Int[Tensor, " P"]

    @property
    def d(self) -> int:
        """Latent dimension."""
        return self.bodies[0].d

    @property
    def space(self) -> int:
        """Number of spatial dimensions."""
        return self.points.shape[1]

    @cached_property
    def every(self) -> MaterialPoints:
        """All material points."""
        own = [(self.body == number)[:, None] for number in range(len(self.bodies))]
        pairs = zip(self.bodies, own, strict=True)
        bases = [body.evaluate_basis(self.points).where(mine, 0.0) for body, mine in pairs]
        return MaterialPoints(self.points, self.bodies, tuple(bases))

    def carry(self, q: Latents) -> Float[Tensor, "B P n"]:
        """Places of all points at states [px]."""
        return self.every.carry(q)

    def jacobian(self, q: Latent) -> Float[Tensor, "P n d"]:
        """Motion of all points per whitened unit at a state [px]."""
        return self.every.jacobian(q)

    def average(self, weights: Float[Tensor, "N P"]) -> MaterialPoints:
        """Weighted means of material points; without any weight a point is still ground."""
        every = self.every
        return MaterialPoints(weights @ every.at, self.bodies, tuple(weights @ each for each in every.bases))


@dataclass(frozen=True)
class BodyReport:
    """What a fit says of one body.

    Args:
        pixels: that belong to it.
        losses: mean loss in withheld frames for each degree of bending that was tried, from 0 on.
        bending: the degree that was chosen.
        scale: of the loss at the end [colour].
        explained: share of the loss of its pixels in withheld frames, if they stayed, that its motion saves.
    """

    pixels: int
    losses: list[float]
    bending: int
    scale: float
    explained: float


@dataclass(frozen=True)
class MatterReport:
    """What a fit says of the matter of a film.

    Args:
        moving: pixels that change with the state at its mean.
        unexplained: of these, the ones that neither a body nor a still background explains.
        frames: that were registered.
        noise: standard deviation of a colour of the film.
        wall_s: time of the fit [s].
    """

    bodies: list[BodyReport]
    moving: int
    unexplained: int
    frames: int
    noise: float
    wall_s: float

    @property
    def warnings(self) -> list[str]:
        """What a field of matter says of itself that its user must know."""
        found = [
            f"body {number} of {body.pixels} pixels keeps its colours poorly: its motion saves "
            f"{body.explained:.0%} of the loss of a still picture. Look at material_paths.png before a push"
            for number, body in enumerate(self.bodies)
            if body.explained < LEAST_EXPLAINED
        ]
        if self.unexplained > MOST_UNEXPLAINED * self.moving:
            found.append(
                f"{self.unexplained} of {self.moving} moving pixels belong to no body: shadows, reflections, "
                "what several bodies cover in turn, or more bodies than matter.bodies"
            )
        return found


def save_matter(
    path: Path | str, field: MatterField, header: Mapping[str, Any], report: MatterReport | None = None
) -> None:
    """Write a field of matter, and what its fit says of it."""
    settings = [
        {"size": each.size, "bending": each.bending, "latent_degree": each.latent_degree}
        for each in field.bodies
    ]
    tensors = {"points": field.points, "body": field.body}
    for i, each in enumerate(field.bodies):
        tensors |= {f"{i}.{name}": getattr(each, name) for name in ("center", "ball", "coefficients")}
        if each.deviations:
            tensors[f"{i}.deviations"] = torch.stack(each.deviations)
    header = {**header, "kind": KIND, "schema": SCHEMA, "bodies": settings}
    if report is not None:
        header["report"] = asdict(report)
    save_artifact(path, tensors, header)


def load_matter(path: Path | str) -> tuple[MatterField, dict[str, Any]]:
    """Read a field of matter and its header; errors as `lagsplat.io.files.artifact.load_artifact`."""
    arrays, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
    bodies = tuple(
        BodyMotion(
            center=tensors[f"{i}.center"],
            ball=tensors[f"{i}.ball"],
            coefficients=tensors[f"{i}.coefficients"],
            deviations=tuple(tensors.get(f"{i}.deviations", ())),  # absent where none are known
            **settings,
        )
        for i, settings in enumerate(header["bodies"])
    )
    return MatterField(bodies, tensors["points"], tensors["body"]), header
