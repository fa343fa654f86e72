"""Figures of forces: nine equilibria in the image, one force in space from three sides, and their errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from string import ascii_lowercase
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from torch import Tensor

from lagsplat.evaluate.forces.motion import SpacePush
from lagsplat.forces import moving_parts
from lagsplat.forces.answer_spread import (
    NINE_IN_TEN,
    find_half_width,
    is_undetermined,
    measure_answer_spread,
)
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.grasp import GraspPoint
from lagsplat.forces.loads import PointLoad, SummedLoad
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.forces.rest_outline import draw_rest_mask
from lagsplat.matter.field import join_points
from lagsplat.report.common.formatting import MINUS, format_number
from lagsplat.report.common.style import PAGE_IN, add_badge, draw_arrow, new_figure, paper_style
from lagsplat.splat.projection import make_view
from lagsplat.views.camera import Camera, orbit_camera

FORCE_COLOUR = "#AA1E1E"
BEYOND = "beyond the recorded range"
MAX_ARROW_SHARE = 0.3  # length of the longest arrow over the smaller side of the image
VIEW_ANGLES_DEG = ((0.0, 0.0), (-12.0, 4.0), (12.0, -4.0))
"""Yaw and pitch of the columns [degree], about the pivot."""
ARROW_SHARE = 0.4  # length of an arrow over the smaller side of the image, at the depth of the pivot
LEAST_SHIFT = 5e-5  # smaller ones are printed as none
MIN_PRINTED_SHIFT = 1e-3  # smaller shifts are printed by their order of magnitude
SUPERSAMPLING = 4  # pixels rendered in place of one of the recording, each way
DOWN, RIGHT = np.array([0.0, 1.0]), np.array([1.0, 0.0])
OBLIQUE = np.array([np.sqrt(0.5), np.sqrt(0.5)])
MIN_WIDTH_PX = 384  # smallest width of a rendered image
N_BACKGROUND = 3
MAPPED_ERRORS = (
    ("direction_deg", "direction of the pushed point", "degrees", 1.0, 60.0),
    ("shape", "shape of the answer", "%", 100.0, 100.0),
    ("amplitude", "amplitude after one poke", "%", 100.0, 100.0),
)


@dataclass(frozen=True)
class ForcePanel:
    """One equilibrium: its forces, how far its state is from rest, and its image.

    ``arrows`` (n, 2, 2) are foot and direction times size of each force, in pixels of the training
    resolution and energy per pixel. ``moved_px`` is how far the matter moved that was pushed first, and
    ``spread`` the covariance of its place [px^2] over laws that the recording allows as well, if known.
    ``is_beyond`` says that the state is outside the visited range.
    """

    name: str
    shift: Float64[np.ndarray, " d"]
    moved_px: float
    arrows: Float64[np.ndarray, "n 2 2"]
    image: Float[np.ndarray, "h w 3"]
    spread: Float64[np.ndarray, "2 2"] | None = None
    is_beyond: bool = False


@dataclass(frozen=True)
class ForcePanels:
    """All panels of a run, with the outline of the object at rest.

    ``object`` (h, w) is true where the image at rest shows the object; ``size`` (rows, columns) is that of
    the training images, in whose pixels arrows are.
    """

    panels: tuple[ForcePanel, ...]
    object: Bool[np.ndarray, "h w"]
    size: tuple[int, int]


@dataclass(frozen=True)
class ImagePush:
    """A force on a grip: unit ``direction`` (right, down) and ``size`` [energy per px]."""

    grip: GraspPoint
    direction: Float64[np.ndarray, "2"]
    size: float

    @property
    def force(self) -> torch.Tensor:
        """The force [energy per px]."""
        return torch.from_numpy(self.size * self.direction)


def stack_pushes(pushes: Sequence[ImagePush | None]) -> PointLoad:
    """The load of one push a row; no force where it is None."""
    some = next(push for push in pushes if push is not None)
    points = join_points([(push or some).grip.points for push in pushes])
    nothing = torch.zeros_like(some.force)
    return PointLoad(points, torch.stack([nothing if push is None else push.force for push in pushes]))


NamedPushes = list[tuple[str, list[ImagePush]]]


def draw_forces(panels: ForcePanels, *, title: str) -> Figure:
    """Draw three by three images of the loaded states.

    Red arrows, all on one scale, start where the pushed matter has come to; the dashed line is the outline of
    what moves, at rest. An ellipse holds the place of that matter nine times in ten.

    Source: paper, figures of interactive forces.
    """
    height, width = panels.size
    largest = max(float(np.linalg.norm(panel.arrows[:, 1], axis=1).max()) for panel in panels.panels)
    scale = MAX_ARROW_SHARE * min(height, width) / largest
    fine_rows, fine_columns = panels.object.shape
    x = width * (np.arange(fine_columns) + 0.5) / fine_columns
    y = height * (np.arange(fine_rows) + 0.5) / fine_rows
    outline = (x, y, panels.object.astype(float))
    with paper_style():
        side = PAGE_IN / 3.0
        rows = -(-len(panels.panels) // 3)
        figure = new_figure(PAGE_IN, rows * (side * height / width + 0.1) + 0.35, title=title)
        axes = figure.subplots(rows, 3, squeeze=False).ravel()
        for axis, letter, panel in zip(axes, ascii_lowercase, panels.panels, strict=False):
            _show(axis, panel.image, panels.size)
            axis.contour(*outline, levels=[0.5], colors="white", linewidths=0.8, linestyles="dashed")
            for foot, force in panel.arrows:
                _draw_force(axis, foot, scale * force)
            if panel.spread is not None:
                _draw_ellipse(axis, panel.arrows[0, 0], panel.spread)
            if panel.is_beyond:
                add_badge(axis, BEYOND)
            axis.set_title(f"({letter}) {panel.name}: {_describe_answer(panel)}", loc="left")
        for axis in axes[len(panels.panels) :]:
            axis.set_axis_off()
    return figure


def _describe_answer(panel: ForcePanel) -> str:
    distance = f"{panel.moved_px:.1f} px"
    if panel.spread is not None and panel.moved_px > 0.0:
        distance += rf" $\pm$ {format_number(find_half_width(panel.spread), digits=1)}"
        distance += ", undetermined" if is_undetermined(panel.spread, panel.moved_px) else ""
    if len(panel.shift) == 1:
        return rf"$\Delta q = {_tell_shift(float(panel.shift[0]))}$, " + distance
    return distance


def _tell_shift(shift: float) -> str:
    return "0" if abs(shift) < LEAST_SHIFT else f"{shift:+.{2 if abs(shift) > 0.05 else 4}f}"


def compute_force_panels(
    point: OperatingPoint,
    config: ForcesConfig,
    *,
    hanging: bool,
    draws: Float64[np.ndarray, "m p"] | None = None,
) -> ForcePanels:
    """Compute the equilibria of the paper's nine panels.

    They are levers, directions and background; what hardly turns is pushed along its way, and an arm that
    hangs at its middle and its tip, across and along. ``draws`` are parameters of laws that the recording
    allows as well, of which ``config.laws`` are used; the first push of all sets the energy scale of each.

    Raises:
        ValueError: nothing moves in the image, or not on both sides of a centre of rotation.

    Source: paper, figures of interactive forces.
    """
    scene, radius = point.find_moving_parts(), config.brush * point.width
    choose = _push_hanging if hanging else _push_rolling if moving_parts.has_levers(scene) else _push_swinging
    named = choose(point, scene, config.response, radius)
    every = [pushes for _, pushes in named]
    first = stack_pushes([pushes[0] for pushes in every])
    second = [pushes[1] if len(pushes) > 1 else None for pushes in every]
    load = SummedLoad((first, stack_pushes(second))) if any(second) else first
    states, spread = point.equilibria(load), None
    if draws is not None:
        reference = PointLoad(first.points[:1], first.force[:1])
        spread = measure_answer_spread(point, draws[: config.laws], load, first.points, reference=reference)
    scale = -(-MIN_WIDTH_PX // point.width)
    images = point.render_images(states, scale=scale)
    panels = []
    for i, ((name, pushes), q, image) in enumerate(zip(named, states, images, strict=True)):
        feet = np.stack([push.grip.place(q).numpy() for push in pushes])
        sizes = np.stack([push.size * push.direction for push in pushes])
        moved_px = float(np.linalg.norm(feet[0] - pushes[0].grip.at.numpy()))
        arrows = np.stack([feet, sizes], axis=1)
        own, shift = None if spread is None else spread[i], (q - point.rest).numpy()
        beyond = float(np.linalg.norm(shift)) > point.visited_radius
        panels.append(ForcePanel(name, shift, moved_px, arrows, image, own, beyond))
    return ForcePanels(tuple(panels), draw_rest_mask(point, scale=scale), (point.height, point.width))


def _push_rolling(
    point: OperatingPoint, scene: moving_parts.MovingParts, response: float, radius: float
) -> NamedPushes:
    """Levers (a)-(c), directions at one material point (d)-(f), background (g)-(i)."""
    levers = moving_parts.choose_lever_points(scene, margin=radius)
    grips = [point.grasp(at, radius=radius) for at in levers]
    far = grips[-1]
    size = point.find_force_size(far, DOWN, share=response)
    named = [("lever", [ImagePush(grip, DOWN, size)]) for grip in grips[:3]]
    named += [("direction", [ImagePush(far, direction, size)]) for direction in (DOWN, OBLIQUE, RIGHT)]
    return named + _push_background(point, scene, ImagePush(far, DOWN, size), radius)


def _push_swinging(
    point: OperatingPoint, scene: moving_parts.MovingParts, response: float, radius: float
) -> NamedPushes:
    """Along the way of three points (a)-(c), other directions at one (d)-(f), background (g)-(i)."""
    points = moving_parts.choose_moving_points(scene, margin=radius)
    grips = [point.grasp(at, radius=radius) for at in points]
    ways = [find_way(grip.jacobian(point.rest)) for grip in grips]
    far, along = grips[-1], ways[-1]
    size = point.find_force_size(far, along, share=response)
    named = [("along its way", [ImagePush(grip, way, size)]) for grip, way in zip(grips, ways, strict=True)]
    across = np.array([-along[1], along[0]])
    turned = (-along, OBLIQUE[0] * (across - along), across)
    named += [("direction", [ImagePush(far, direction, size)]) for direction in turned]
    return named + _push_background(point, scene, ImagePush(far, along, size), radius)


def find_way(jacobian: Float[Tensor, "n d"]) -> Float64[np.ndarray, " n"]:
    """Unit direction in which a point moves most, per deviation of the state; downwards or to the right."""
    way = torch.linalg.svd(jacobian)[0][:, 0].numpy()
    return way * np.sign(way[np.abs(way).argmax()])


def _push_background(
    point: OperatingPoint, scene: moving_parts.MovingParts, push: ImagePush, radius: float
) -> NamedPushes:
    """The same force where the picture never moves."""
    taken = scene.object.copy()
    taken[-round(MAX_ARROW_SHARE * point.height) :] = True  # where an arrow downwards would leave the image
    points = moving_parts.choose_background_points(taken, N_BACKGROUND, margin=2 * radius)
    grips = [point.grasp(at, radius=radius) for at in points]
    return [("background", [ImagePush(grip, push.direction, push.size)]) for grip in grips]


def _push_hanging(
    point: OperatingPoint, scene: moving_parts.MovingParts, response: float, radius: float
) -> NamedPushes:
    """Across and along at the tip and the middle, either way, and two opposed forces."""
    *points, along = moving_parts.choose_hanging_points(scene)
    middle, tip = (point.grasp(at, radius=radius) for at in points)
    across = np.array([-along[1], along[0]])
    across = across * np.sign(across[0])
    size = point.find_force_size(tip, across, share=response)
    axial = point.find_force_size(tip, along, share=response)
    named: NamedPushes = []
    for name, grip, direction, amount in (
        ("across the tip", tip, across, size),
        ("across the middle", middle, across, size),
        ("along, at the tip", tip, -along, axial),
        ("along, at the middle", middle, -along, axial),
    ):
        named += [(name, [ImagePush(grip, sign * direction, amount)]) for sign in (-1.0, 1.0)]
    return [*named, ("opposed", [ImagePush(middle, -across, size), ImagePush(tip, across, size)])]


def draw_space_push(point: OperatingPoint, push: SpacePush, *, title: str) -> Figure:
    """Draw rest, the force across the motion and the force downwards, each from three viewpoints.

    Arrows start where the pushed matter has come to. They have one length in space, whatever the size of the
    force, and only the viewpoint foreshortens them.

    Source: paper, Figure "Applying a force inside the 3D scene".
    """
    height, width = point.height, point.width
    length = ARROW_SHARE * min(height, width)
    cameras = [turn_camera(point, yaw, pitch) for yaw, pitch in VIEW_ANGLES_DEG]
    q = torch.from_numpy(push.states)
    names = ("no force", "a force across the motion", "a force downwards")
    with paper_style():
        side = PAGE_IN / 3.0
        figure = new_figure(PAGE_IN, 3 * (side * height / width + 0.12) + 0.35, title=title)
        axes = figure.subplots(3, 3, squeeze=False)
        for column, (camera, (yaw, pitch)) in enumerate(zip(cameras, VIEW_ANGLES_DEG, strict=True)):
            images = point.render_images(q, scale=SUPERSAMPLING, view=make_view([camera]))
            for row, (axis, image) in enumerate(zip(axes[:, column], images, strict=True)):
                _show(axis, image, (height, width))
                if row:
                    foot = push.grip.place(q[row]).numpy()
                    start, stop = camera.project(np.stack([foot, foot + length * push.directions[row - 1]]))
                    _draw_force(axis, start, stop - start)
                    if np.linalg.norm(push.states[row] - push.states[0]) > point.visited_radius:
                        add_badge(axis, BEYOND)
                text = (
                    f"yaw {_tell_angle(yaw)}, pitch {_tell_angle(pitch)}"
                    if row == 0
                    else _describe_shift(push, row)
                )
                axis.set_title(f"({ascii_lowercase[3 * row + column]}) {text}", loc="left")
        for axis, name in zip(axes[:, 0], names, strict=True):
            axis.set_ylabel(name)
    return figure


def _tell_angle(degrees: float) -> str:
    return f"{degrees:+.0f}°".replace("-", MINUS) if degrees else "0°"


def turn_camera(point: OperatingPoint, yaw_deg: float, pitch_deg: float) -> Camera:
    """Turn the camera of the recording about the pivot of the coordinates of space [degree]."""
    view = point.autoencoder.filmed_view(point.autoencoder.gaussians.center)
    focal, middle = tuple(view.focal[0].tolist()), tuple(view.middle[0].tolist())
    size = {"height": point.height, "width": point.width}
    front = Camera(rotation=np.eye(3), position=np.zeros(3), focal=focal, middle=middle, **size)
    return orbit_camera(front, focal[0], yaw_deg=yaw_deg, pitch_deg=pitch_deg)


def _describe_shift(push: SpacePush, row: int) -> str:
    """The generalised force of a row, and how far it moves the state."""
    shift = push.states[row] - push.states[0]
    direction, rest = torch.from_numpy(push.directions[row - 1]), torch.from_numpy(push.states[0])
    load = push.size * push.grip.pull_back(direction, rest).norm()
    pulled, size = (f"{value:.1g}" for value in (float(load), float(np.linalg.norm(shift))))
    if np.linalg.norm(shift) < MIN_PRINTED_SHIFT:
        return rf"$|J^T f|$ = {pulled}, $|\Delta q|$ = {size}"
    return rf"$|J^T f|$ = {pulled}, $\Delta q$ = " + ", ".join(f"{x:+.2f}" for x in shift)


def draw_force_map(image: Float[np.ndarray, "H W 3"], truth: Mapping[str, Any], *, title: str) -> Figure:
    """Draw the object at rest three times, with the median error of forces on each point in colour.

    ``truth`` is what `lagsplat.evaluate.forces.accuracy.compare_answers` returns, or the reason why there is
    nothing.
    """
    height, width = image.shape[:2]
    with paper_style():
        figure = new_figure(PAGE_IN, PAGE_IN / 3.0 * height / width + 1.05, title=title)
        if "refused" in truth:
            figure.text(0.01, 0.5, f"nothing was measured: {truth['refused']}", wrap=True)
            return figure
        rows = truth["map"]
        for axis, (name, what, unit, scale, most) in zip(figure.subplots(1, 3), MAPPED_ERRORS, strict=True):
            _show(axis, image, (height, width), alpha=0.45)
            errors = [(*row["place"], scale * row[name]) for row in rows if row[name] is not None]
            x, y, values = np.array(errors).reshape(-1, 3).T
            dots = axis.scatter(
                x, y, c=values, s=26, vmin=0.0, vmax=most, cmap="viridis_r", edgecolors="k", linewidths=0.3
            )
            label = f"{unit}; median at each of {len(values)} points"
            below: dict[str, Any] = {"orientation": "horizontal", "shrink": 0.9, "aspect": 30}
            figure.colorbar(dots, ax=axis, label=label, extend="max", **below)
            axis.set_title(what)
    return figure


def _show(axis: Axes, image: np.ndarray, size: tuple[int, int], *, alpha: float = 1.0) -> None:
    """Show an image over ``size`` (rows, columns) pixels, in whose units everything else is drawn."""
    height, width = size
    axis.imshow(image.clip(0.0, 1.0), extent=(0, width, height, 0), alpha=alpha)
    axis.set(xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0))


def _draw_ellipse(axis: Axes, middle: np.ndarray, spread: Float64[np.ndarray, "2 2"]) -> None:
    """The ellipse that holds a place nine times in ten."""
    values, vectors = np.linalg.eigh(NINE_IN_TEN * spread)
    width, height = 2.0 * np.sqrt(np.clip(values[::-1], 0.0, None))
    angle = float(np.degrees(np.arctan2(vectors[1, -1], vectors[0, -1])))
    axis.add_patch(
        Ellipse(tuple(middle), width, height, angle=angle, fill=False, edgecolor="white", linewidth=0.8)
    )


def _draw_force(axis: Axes, foot: np.ndarray, vector: np.ndarray) -> None:
    """A red arrow, its foot marked [px]."""
    draw_arrow(axis, foot, foot + vector, FORCE_COLOUR, linewidth=1.4, rim=2.6, shrink=0.0)
    axis.plot(*foot, "o", color=FORCE_COLOUR, markersize=2.5, markeredgecolor="white", markeredgewidth=0.5)
