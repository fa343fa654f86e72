"""A force in space that moves nothing and one that does, seen from three sides."""

from string import ascii_lowercase

import numpy as np
import torch
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lagsplat.evaluate.force_space import SpacePush
from lagsplat.forces.held import Held
from lagsplat.report.force_figure import draw_arrow
from lagsplat.report.style import PAGE_IN, new_figure, paper_style
from lagsplat.splat.projection import View, view_of
from lagsplat.views.camera import Camera, orbit

SIDES = ((0.0, 0.0), (-12.0, 4.0), (12.0, -4.0))
"""Yaw and pitch of the columns [degree], about the pivot."""
ARROW = 0.4
"""Of the picture's smaller side, at the pivot's depth."""
FAINT = 1e-3
"""A shift below it is told by its order of magnitude."""
FINE = 4
"""Pixels drawn in place of one of the film's, each way."""


def draw_space_push(held: Held, push: SpacePush, *, title: str) -> Figure:
    """Three by three: rest, the force across the motion, the force downwards, each from three sides.

    Arrows start where the pushed matter has come to, and have one length in space, which says nothing of the
    force's size and which only the viewpoint foreshortens.

    Source: paper, Figure "Applying a force inside the 3D scene".
    """
    height, width = held.kinematics.height, held.kinematics.width
    length = ARROW * min(height, width)
    cameras = [sideways(held, yaw, pitch) for yaw, pitch in SIDES]
    q = torch.from_numpy(push.states)
    names = ("no force", "a force across the motion", "a force downwards")
    with paper_style():
        side = PAGE_IN / 3.0
        figure = new_figure(PAGE_IN, 3 * (side * height / width + 0.12) + 0.35, title=title)
        axes = figure.subplots(3, 3, squeeze=False)
        for column, (camera, (yaw, pitch)) in enumerate(zip(cameras, SIDES, strict=True)):
            pictures = held.pictures(q, scale=FINE, view=view_of([camera]))
            for row, (axis, picture) in enumerate(zip(axes[:, column], pictures, strict=True)):
                axis.imshow(picture.clip(0.0, 1.0), extent=(0, width, height, 0))
                if row:
                    foot = push.grip.place(q[row]).numpy()
                    _arrow(axis, camera, foot, length * push.directions[row - 1])
                told = f"yaw {yaw:+.0f}°, pitch {pitch:+.0f}°" if row == 0 else _moved(push, row)
                axis.set_title(f"({ascii_lowercase[3 * row + column]}) {told}", loc="left")
                axis.set(xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0))
        for axis, name in zip(axes[:, 0], names, strict=True):
            axis.set_ylabel(name)
    return figure


def sideways(held: Held, yaw_deg: float, pitch_deg: float) -> Camera:
    """The film's camera, moved about the pivot of the coordinates of space."""
    own: View = held.autoencoder.filmed_view(held.autoencoder.gaussians.center)
    focal, middle = own.focal[0].tolist(), own.middle[0].tolist()
    front = Camera(
        rotation=np.eye(3),
        position=np.zeros(3),
        focal=(focal[0], focal[1]),
        middle=(middle[0], middle[1]),
        height=held.kinematics.height,
        width=held.kinematics.width,
    )
    return orbit(front, focal[0], yaw_deg=yaw_deg, pitch_deg=pitch_deg)


def _moved(push: SpacePush, row: int) -> str:
    """The pull-back of the row's force, and how far it moves the state."""
    shift = push.states[row] - push.states[0]
    load = push.size * push.grip.pull_back(torch.from_numpy(push.directions[row - 1])).norm()
    pulled, size = (f"{value:.1g}" for value in (float(load), float(np.linalg.norm(shift))))
    if np.linalg.norm(shift) < FAINT:
        return rf"$|J^T f|$ = {pulled}, $|\Delta q|$ = {size}"
    return rf"$|J^T f|$ = {pulled}, $\Delta q$ = " + ", ".join(f"{x:+.2f}" for x in shift)


def _arrow(axis: Axes, camera: Camera, foot: Float64[np.ndarray, "3"], way: Float64[np.ndarray, "3"]) -> None:
    start, stop = camera.project(np.stack([foot, foot + way]))
    draw_arrow(axis, start, stop - start)
