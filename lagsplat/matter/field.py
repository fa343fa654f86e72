"""The matter of a film: material points, the body each belongs to, and how the bodies move with the state."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
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

    def carry(self, q: Latents) -> Float[Tensor, "B P n"]:
        """Places of all points at states [px]."""
        places = self.points.expand(len(q), -1, -1).clone()
        for number, motion in enumerate(self.bodies):
            own = self.body == number
            places[:, own] = motion.carry(self.points[own], q)
        return places

    def jacobian(self, q: Latent) -> Float[Tensor, "P n d"]:
        """Motion of all points per whitened unit at a state [px]."""
        slopes = self.points.new_zeros(*self.points.shape, self.d)
        for number, motion in enumerate(self.bodies):
            own = self.body == number
            slopes[own] = motion.jacobian(self.points[own], q[None])[0]
        return slopes


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
            **settings,
        )
        for i, settings in enumerate(header["bodies"])
    )
    return MatterField(bodies, tensors["points"], tensors["body"]), header
