"""Where the picture stands in the scene: a sheet at z = 0, x to the right, y up, seen from the front."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

LONG = 4.0
"""Length of the picture's longer side in the scene."""
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class Plane:
    """A picture of ``width`` x ``height`` pixels (training resolution), its middle at the origin.

    It turns what a pointer means in the scene into a place in the picture; of a run whose Gaussians live in
    space `lagsplat.viewer.room.Room` knows where things are.
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
