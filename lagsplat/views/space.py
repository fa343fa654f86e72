"""The coordinates in which Gaussians of space live: those of the reference camera, in its own pixels."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.views.camera import Camera, Point


@dataclass(frozen=True)
class Space:
    """The axes of the ``reference`` camera with itself at the origin, and lengths in units of what its pixel
    covers at ``depth`` [unit of the world], where the pivot lies: step sizes in pixels then mean the same in
    the plane and in space, and the numbers are those of the picture.

    Raises:
        ValueError: a depth that is not positive.
    """

    reference: Camera
    depth: float

    def __post_init__(self) -> None:
        if not (self.depth > 0 and np.isfinite(self.depth)):
            raise ValueError(
                f"the pivot's depth is {self.depth}: it must lie ahead of the reference camera, a positive "
                "distance in the unit of the cameras' positions"
            )

    @property
    def unit(self) -> float:
        """What one unit of length measures in the world."""
        return self.depth / self.reference.focal[0]

    @property
    def pivot(self) -> Point:
        """The point ahead of the reference camera at the pivot's depth, in the world."""
        return self.reference.position + self.depth * self.reference.rotation[2]

    def resized(self, height: int, width: int) -> "Space":
        """The coordinates that belong to another size of the reference camera's pictures."""
        return replace(self, reference=self.reference.resized(height, width))

    def seen_by(self, camera: Camera) -> Camera:
        """A camera of the world, told in these coordinates."""
        return replace(
            camera,
            rotation=camera.rotation @ self.reference.rotation.T,
            position=self.inside(camera.position[None])[0],
        )

    def inside(self, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 3"]:
        """World points in these coordinates."""
        return self.reference.within(points) / self.unit

    def outside(self, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 3"]:
        """Points of these coordinates in the world."""
        return self.unit * points @ self.reference.rotation + self.reference.position
