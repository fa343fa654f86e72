"""Coordinates of the browser's scene: x right, y up, z towards the recording camera, the image at z = 0."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from viser.transforms import SO3

from lagsplat.views.camera import Camera, center_camera

LONG = 4.0  # length of the longer side of the image in the scene
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class ImagePlane:
    """An image of ``width`` x ``height`` pixels (training resolution), centred at the scene's origin."""

    width: int
    height: int

    @property
    def unit(self) -> float:
        """Pixels per unit of the scene."""
        return max(self.width, self.height) / LONG

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in the scene."""
        return self.width / self.unit, self.height / self.unit

    def to_scene(
        self, pixels: Float64[np.ndarray, "*B 2"], *, lift: float = 0.0
    ) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of pixels, raised by ``lift`` above the image."""
        x = (pixels[..., 0] - 0.5 * self.width) / self.unit
        y = (0.5 * self.height - pixels[..., 1]) / self.unit
        return np.stack([x, y, np.full_like(x, lift)], axis=-1)

    def to_pixels(self, point: Vector3, *, eye: Vector3) -> Float64[np.ndarray, "2"]:
        """The pixel that ``point`` covers for an observer at ``eye``.

        Raises:
            ValueError: the line of sight does not meet the plane of the image in front of the eye.
        """
        at, start = np.asarray(point, np.float64), np.asarray(eye, np.float64)
        with np.errstate(all="ignore"):
            ray = at - start
            along = -start[2] / ray[2]
            hit = (start + along * ray) * self.unit
        if along <= 0.0 or ray[2] == 0.0:
            raise ValueError("the pointer does not point at the image; turn the view back to its front")
        if not np.isfinite(hit).all():
            raise ValueError("the position of the pointer is not finite; nothing was pushed")
        return np.array([hit[0] + 0.5 * self.width, 0.5 * self.height - hit[1]])


FLIP = np.array([1.0, -1.0, -1.0])
"""The scene has y up and z towards the recording camera, space has y down and z away from it."""
ROOM = 1.12  # size of the view from the front, as a multiple of the recorded image
FARTHEST = 1e6  # largest coordinate of a visitor's camera in the scene
SLIM = 8.0  # largest ratio of the sides of a window; a slimmer one is drawn with this ratio


@dataclass(frozen=True)
class SceneFrame:
    """Maps the space of `lagsplat.views.camera` to the scene.

    The pivot of a recording camera with the focal length ``focal`` [px] lies at the scene's origin, where
    its image would be the ``image_plane``.
    """

    focal: float
    image_plane: ImagePlane

    @property
    def pivot(self) -> Float64[np.ndarray, "3"]:
        """The origin of the scene in space [px at the pivot]."""
        return np.array([0.0, 0.0, self.focal])

    @property
    def eye(self) -> tuple[float, float, float]:
        """Position of the recording camera in the scene."""
        return 0.0, 0.0, self.focal / self.image_plane.unit

    def fov(self, aspect: float) -> float:
        """Vertical field of view [rad] that shows the whole recorded image in a window of ``aspect``."""
        half = 0.5 * ROOM * max(self.image_plane.height, self.image_plane.width / aspect)
        return float(2.0 * np.arctan(half / self.focal))

    def to_scene(self, points: Float64[np.ndarray, "*B 3"]) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of points of space [px at the pivot]."""
        return (points - self.pivot) * FLIP / self.image_plane.unit

    def to_space(self, points: Float64[np.ndarray, "*B 3"]) -> Float64[np.ndarray, "*B 3"]:
        """Points of space [px at the pivot] of scene coordinates."""
        return self.pivot + self.image_plane.unit * points * FLIP

    def camera(
        self, *, wxyz: np.ndarray, position: np.ndarray, fov: float, aspect: float, side: int
    ) -> Camera:
        """Convert a visitor's camera to the coordinates of the run.

        ``wxyz`` is the quaternion from camera coordinates (x right, y down, z ahead) to the scene's, in which
        ``position`` is given; ``fov`` is the vertical field of view [rad], ``aspect`` the width of the window
        over its height and ``side`` the number of pixels along the longer side.

        Raises:
            ValueError: numbers that define no camera.
        """
        numbers = np.concatenate([np.ravel(wxyz), np.ravel(position), [fov, aspect]]).astype(np.float64)
        near = len(numbers) == 9 and np.isfinite(numbers).all() and np.abs(numbers[:7]).max() <= FARTHEST
        if not (near and numbers[:4].any() and 0.0 < fov < np.pi and aspect > 0.0):
            raise ValueError(
                f"a camera at {np.ravel(position).tolist()} with an angle of {fov} rad and an aspect of "
                f"{aspect} sees nothing; nothing was drawn or pushed"
            )
        share = float(np.clip(aspect, 1.0 / SLIM, SLIM))
        height, width = round(side * min(1.0, 1.0 / share)), round(side * min(1.0, share))
        focal = 0.5 * height / float(np.tan(0.5 * fov))
        rotation = SO3(numbers[:4]).as_matrix().T * FLIP
        position = self.to_space(numbers[4:7])
        return center_camera(rotation, position, focal=focal, height=height, width=width)
