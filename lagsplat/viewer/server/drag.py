"""What a pointer means that is pressed and moved: a place on the matter, and a way to pull it."""

from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.forces.equilibrium import OperatingPoint
from lagsplat.forces.grasp import Place, Point, cast_ray
from lagsplat.splat.projection import make_view
from lagsplat.views.camera import Camera

Pointer = Float64[np.ndarray, "2"]


@runtime_checkable
class Drag(Protocol):
    """One drag, from its ``press`` on [px]."""

    press: Pointer

    def aim(self, q: Float64[np.ndarray, " d"]) -> tuple[Point | Place, int | None]:
        """The place that was pressed at the state ``q`` [px], and in space the Gaussian that was met.

        Raises:
            ValueError: there is nothing.
        """

    def way(self, pointer: Pointer) -> Float64[np.ndarray, " n"]:
        """How far the pointer has come [px], in the picture or in space."""


class ImageDrag:
    """A press in the picture [px of the training resolution]."""

    def __init__(self, press: Pointer) -> None:
        self.press = press

    def aim(self, q: Float64[np.ndarray, " d"]) -> tuple[Point, None]:
        """The press itself."""
        return (float(self.press[0]), float(self.press[1])), None

    def way(self, pointer: Pointer) -> Float64[np.ndarray, "2"]:
        """From the press to the pointer."""
        return pointer - self.press


class RayDrag:
    """A press in a pixel of a ``camera`` that looks into space.

    The ray through the pixel meets a Gaussian, and the drag lives in the plane through that point parallel to
    the image: what the pointer does on the screen, the pulled point would do under it.

    Source: paper, "Forces in three dimensions".
    """

    def __init__(self, held: OperatingPoint, camera: Camera, press: Pointer) -> None:
        self.held, self.camera, self.press = held, camera, press
        self.depth = 0.0

    def aim(self, q: Float64[np.ndarray, " d"]) -> tuple[Place, int]:
        """The point of the ray beside the Gaussian that it meets first, and its number.

        Raises:
            ValueError: as `lagsplat.forces.grasp.cast_ray`.
        """
        pixel = (float(self.press[0]), float(self.press[1]))
        hit = cast_ray(
            self.held.autoencoder, self.held.chart, torch.from_numpy(q), make_view([self.camera]), pixel,
            size=(self.camera.height, self.camera.width),
        )  # fmt: skip
        self.depth = hit.depth
        x, y, z = (self.camera.position + hit.depth * self.camera.ray(pixel)).tolist()
        return (x, y, z), hit.gaussian

    def way(self, pointer: Pointer) -> Float64[np.ndarray, "3"]:
        """From the press to the pointer, in the plane of the drag; nothing before `aim` has met something."""
        right, down = self.depth * (pointer - self.press) / np.array(self.camera.focal)
        return right * self.camera.rotation[0] + down * self.camera.rotation[1]
