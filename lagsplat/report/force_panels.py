"""What the nine panels of a figure of forces show: where each force acts, and the state that balances it."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64

from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.grip import Grip, NothingThereError, Point, brush
from lagsplat.forces.held import Held
from lagsplat.forces.outline import outlined
from lagsplat.forces.scene import (
    background_points,
    hanging_points,
    lever_points,
    scene_at,
)

DOWN, RIGHT = np.array([0.0, 1.0]), np.array([1.0, 0.0])
OBLIQUE = np.array([np.sqrt(0.5), np.sqrt(0.5)])
FINE = 384
"""Pixels that a drawn picture's width has at least."""
BACKGROUND = 3


@dataclass(frozen=True)
class Push:
    """A force on a grip: unit ``direction`` (right, down) and ``size`` [energy per px]."""

    grip: Grip
    direction: Float64[np.ndarray, "2"]
    size: float

    @property
    def load(self) -> torch.Tensor:
        """The generalised force (d,)."""
        return self.size * self.grip.pull_back(torch.from_numpy(self.direction))


@dataclass(frozen=True)
class Panel:
    """One equilibrium: its ``pushes``, its state, how far that is from rest, and its picture.

    ``arrows`` (n, 2, 2) are foot and direction times size of each force, in pixels of the training
    resolution and energy per pixel. ``moved_px`` is the way of the matter that was pushed first.
    """

    name: str
    q: Float64[np.ndarray, " d"]
    shift: Float64[np.ndarray, " d"]
    moved_px: float
    arrows: Float64[np.ndarray, "n 2 2"]
    picture: Float[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class Panels:
    """All panels of a run, with the outline of the object at rest.

    ``object`` (h, w) is true where the picture at rest shows the object, ``size`` (rows, columns) that of the
    training pictures, in whose pixels arrows are; ``reach`` the visited range.
    """

    panels: tuple[Panel, ...]
    object: Bool[np.ndarray, "h w"]
    size: tuple[int, int]
    rest: Float64[np.ndarray, " d"]
    reach: float


def push_panels(held: Held, config: ForcesConfig, *, hanging: bool) -> Panels:
    """The paper's nine panels: levers, directions and background of what has one coordinate; what hangs is
    pushed at its middle and its tip, across and along.

    Raises:
        ValueError: nothing moves in the picture, or not on both sides of a centre of rotation.

    Source: paper, figures of interactive forces.
    """
    scene = scene_at(held.autoencoder, held.chart, held.rest.numpy())
    radius = config.brush * held.kinematics.width
    named = _hanging(held, config, radius) if hanging else _rolling(held, config, radius)
    loads = torch.stack([torch.stack([push.load for push in pushes]).sum(0) for _, pushes in named])
    states = held.settled(loads)
    scale = -(-FINE // held.kinematics.width)
    pictures = held.pictures(states, scale=scale)
    panels = tuple(
        _panel(held, name, pushes, q, picture)
        for (name, pushes), q, picture in zip(named, states, pictures, strict=True)
    )
    seen = outlined(held.pictures(held.rest[None], scale=scale)[0], scene)
    return Panels(panels, seen, scene.motion.shape, held.rest.numpy(), held.reach)


def _panel(
    held: Held, name: str, pushes: list[Push], q: torch.Tensor, picture: Float[np.ndarray, "h w 3"]
) -> Panel:
    feet = np.stack([push.grip.place(q).numpy() for push in pushes])
    sizes = np.stack([push.size * push.direction for push in pushes])
    moved = float(np.linalg.norm(feet[0] - pushes[0].grip.at.numpy()))
    return Panel(name, q.numpy(), (q - held.rest).numpy(), moved, np.stack([feet, sizes], 1), picture)


def _rolling(held: Held, config: ForcesConfig, radius: float) -> list[tuple[str, list[Push]]]:
    """Levers (a)-(c), directions at one material point (d)-(f), background (g)-(i)."""
    scene = scene_at(held.autoencoder, held.chart, held.rest.numpy())
    grips = [_grip(held, point, radius) for point in lever_points(scene, margin=radius)]
    far = grips[-1]
    size = held.magnitude(far, DOWN, share=config.response)
    named = [("lever", [Push(grip, DOWN, size)]) for grip in grips[:3]]
    named += [("direction", [Push(far, direction, size)]) for direction in (DOWN, OBLIQUE, RIGHT)]
    found = []
    for point in background_points(scene, 4 * BACKGROUND, margin=2 * radius):
        try:
            found.append(_grip(held, point, radius))
        except NothingThereError:  # the background colour has no Gaussian there
            continue
    return named + [("background", [Push(grip, DOWN, size)]) for grip in found[:BACKGROUND]]


def _hanging(held: Held, config: ForcesConfig, radius: float) -> list[tuple[str, list[Push]]]:
    """Across and along at the tip and the middle, either way, and two opposed forces."""
    scene = scene_at(held.autoencoder, held.chart, held.rest.numpy())
    *points, along = hanging_points(scene)
    middle, tip = (_grip(held, point, radius) for point in points)
    across = np.array([-along[1], along[0]])
    across = across * np.sign(across[0])
    size = held.magnitude(tip, across, share=config.response)
    axial = held.magnitude(tip, along, share=config.response)
    named = [
        (name, [Push(grip, sign * direction, amount)])
        for name, grip, direction, amount in (
            ("across the tip", tip, across, size),
            ("across the middle", middle, across, size),
            ("along, at the tip", tip, -along, axial),
            ("along, at the middle", middle, -along, axial),
        )
        for sign in (-1.0, 1.0)
    ]
    return [*named, ("opposed", [Push(middle, -across, size), Push(tip, across, size)])]


def _grip(held: Held, point: Point, radius: float) -> Grip:
    return brush(held.kinematics, held.rest, point, radius=radius)
