"""Which points of a recording another camera sees, where other points may hide them."""

import numpy as np
import torch
from jaxtyping import Bool
from scipy.ndimage import minimum_filter
from torch import Tensor

from lagsplat.matter.blurred_film import project_points
from lagsplat.matter.body_motion import Points
from lagsplat.views.camera import Camera

FOOTPRINT = 3  # pixels along each side that a point covers: from other sides they lie apart
AHEAD = 0.05  # of its depth, that what hides a point is nearer; set by hand, above the errors of depths


class DepthBuffer:
    """The least depth that each pixel of a camera sees.

    Args:
        points: what there is to see [px]; NaN if unknown.
        camera: in their coordinates.
    """

    def __init__(self, points: Points, camera: Camera) -> None:
        self.camera = camera
        self.front = np.full((camera.height, camera.width), np.inf)
        pixel, depth, inside = self._locate(points)
        np.minimum.at(self.front, tuple(pixel[inside].T), depth[inside])
        self.front = minimum_filter(self.front, FOOTPRINT)

    def shows(self, points: Points) -> Bool[Tensor, " P"]:
        """Whether each point is in the image and nothing hides it."""
        pixel, depth, inside = self._locate(points)
        shown = np.zeros(len(points), dtype=bool)
        shown[inside] = depth[inside] < (1.0 + AHEAD) * self.front[tuple(pixel[inside].T)]
        return torch.from_numpy(shown)

    def _locate(self, points: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row and column of each point, its depth, and whether it is in the image."""
        places, _ = project_points(self.camera, points)
        pixel = np.floor(places.nan_to_num(nan=-1.0).flip(1).numpy()).astype(int)
        inside = ((pixel >= 0) & (pixel < self.front.shape)).all(1)
        return pixel, self.camera.within(points.numpy())[:, 2], inside
