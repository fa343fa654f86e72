"""Where the picture stands in the scene: a sheet at z = 0, x to the right, y up, seen from the front.

Where space stands in the scene, and what a visitor's camera there sees of it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from viser.transforms import SO3

from lagsplat.views.camera import Camera

LONG = 4.0
"""Length of the picture's longer side in the scene."""
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class ImagePlane:
    """A picture of ``width`` x ``height`` pixels (training resolution), its middle at the origin.

    It turns what a pointer means in the scene into a place in the picture; of a run whose Gaussians live in
    space `lagsplat.viewer.rendering.scene_frame.SceneFrame` knows where things are.
    """

    width: int
    height: int

    @property
    def unit(self) -> float:
        """Pixels in one unit of the scene."""
        return max(self.width, self.height) / LONG

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in the scene."""
        return self.width / self.unit, self.height / self.unit

    def to_scene(
        self, pixels: Float64[np.ndarray, "*B 2"], *, lift: float = 0.0
    ) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of places in the picture, ``lift`` before it."""
        x = (pixels[..., 0] - 0.5 * self.width) / self.unit
        y = (0.5 * self.height - pixels[..., 1]) / self.unit
        return np.stack([x, y, np.full_like(x, lift)], axis=-1)

    def to_pixels(self, point: Vector3, *, eye: Vector3) -> Float64[np.ndarray, "2"]:
        """The place in the picture that ``point`` covers for who looks from ``eye``.

        Raises:
            ValueError: the line of sight does not meet the picture's plane in front of the eye.
        """
        at, start = np.asarray(point, np.float64), np.asarray(eye, np.float64)
        with np.errstate(all="ignore"):
            ray = at - start
            along = -start[2] / ray[2]
            met = (start + along * ray) * self.unit
        if along <= 0.0 or ray[2] == 0.0:
            raise ValueError("the pointer does not point at the picture; turn the view back to its front")
        if not np.isfinite(met).all():
            raise ValueError("the pointer's place is not finite; nothing was pushed")
        return np.array([met[0] + 0.5 * self.width, 0.5 * self.height - met[1]])


FLIP = np.array([1.0, -1.0, -1.0])
"""The scene has y up and z towards the film's camera, space has y down and z ahead of it."""
ROOM = 1.12
"""Of the film's picture: how much of space is seen from the front."""
FARTHEST = 1e6
"""From the scene's middle: a visitor does not go further."""
SLIM = 8.0
"""Sides of a window: one that is slimmer is drawn as slim as this."""


@dataclass(frozen=True)
class SceneFrame:
    """Space as `lagsplat.views.camera` has it, the pivot of a film with ``focal`` length [px] at the scene's
    origin, where the film's picture would be the ``plane``.
    """

    focal: float
    plane: ImagePlane

    @property
    def pivot(self) -> Float64[np.ndarray, "3"]:
        """The middle of the scene [px at the pivot]."""
        return np.array([0.0, 0.0, self.focal])

    @property
    def eye(self) -> tuple[float, float, float]:
        """Where the film's camera stands in the scene."""
        return 0.0, 0.0, self.focal / self.plane.unit

    def fov(self, aspect: float) -> float:
        """Vertical angle [rad] at which the film's camera shows its whole picture in a window."""
        half = 0.5 * ROOM * max(self.plane.height, self.plane.width / aspect)
        return float(2.0 * np.arctan(half / self.focal))

    def to_scene(self, points: Float64[np.ndarray, "*B 3"]) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of points of space [px at the pivot]."""
        return (points - self.pivot) * FLIP / self.plane.unit

    def to_space(self, points: Float64[np.ndarray, "*B 3"]) -> Float64[np.ndarray, "*B 3"]:
        """Points of space [px at the pivot] of scene coordinates."""
        return self.pivot + self.plane.unit * points * FLIP

    def camera(
        self,
        *,
        wxyz: Float64[np.ndarray, "4"],
        position: Float64[np.ndarray, "3"],
        fov: float,
        aspect: float,
        side: int,
    ) -> Camera:
        """A visitor's camera in the run's coordinates, with ``side`` pixels along its longer side.

        ``wxyz`` turns camera coordinates (x right, y down, z ahead) into the scene's, ``fov`` is vertical
        [rad], ``aspect`` the width of the window over its height.

        Raises:
            ValueError: numbers that are no camera's.
        """
        told = np.concatenate([np.ravel(wxyz), np.ravel(position), [fov, aspect]]).astype(np.float64)
        near = len(told) == 9 and np.isfinite(told).all() and np.abs(told[:7]).max() <= FARTHEST
        if not (near and told[:4].any() and 0.0 < fov < np.pi and aspect > 0.0):
            raise ValueError(
                f"a camera at {np.ravel(position).tolist()} with an angle of {fov} rad and an aspect of "
                f"{aspect} sees nothing; nothing was drawn or pushed"
            )
        share = float(np.clip(aspect, 1.0 / SLIM, SLIM))
        height, width = round(side * min(1.0, 1.0 / share)), round(side * min(1.0, share))
        focal = 0.5 * height / float(np.tan(0.5 * fov))
        return Camera(
            rotation=SO3(told[:4]).as_matrix().T * FLIP,
            position=self.to_space(told[4:7]),
            focal=(focal, focal),
            middle=(0.5 * width, 0.5 * height),
            height=height,
            width=width,
        )
