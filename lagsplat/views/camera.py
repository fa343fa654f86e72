"""A pinhole camera, and how it sees a plane.

World coordinates are metres, x to the right, y down, z away from the frontal camera: the plane of motion of a
planar mechanism is z = 0. Image coordinates follow `lagsplat.shapes`: the first pixel's centre is (0.5, 0.5).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Point = Float64[np.ndarray, "3"]
Homography = Float64[np.ndarray, "3 3"]


@dataclass(frozen=True)
class Camera:
    """Where a camera stands and how it projects.

    ``rotation`` turns world into camera coordinates (x right, y down, z ahead), ``position`` is in the world
    [m], ``focal`` [pixel], ``height`` and ``width`` [pixel]; the principal point is the middle.
    """

    rotation: Float64[np.ndarray, "3 3"]
    position: Point
    focal: float
    height: int
    width: int

    def project(self, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 2"]:
        """Image coordinates [pixel] of world points [m]; meaningless for points behind the camera."""
        seen = (points - self.position) @ self.rotation.T
        return self.focal * seen[:, :2] / seen[:, 2:] + 0.5 * np.array([self.width, self.height])

    def of_plane(self, origin: Point, right: Point, down: Point) -> Homography:
        """From (a, b, 1) on the plane ``origin + a right + b down`` to homogeneous image coordinates.

        Source: Hartley and Zisserman, Multiple View Geometry, section 8.1.
        """
        middle = np.array(
            [[self.focal, 0, 0.5 * self.width], [0, self.focal, 0.5 * self.height], [0, 0, 1.0]]
        )
        columns = [self.rotation @ right, self.rotation @ down, self.rotation @ (origin - self.position)]
        return middle @ np.stack(columns, axis=1)


def look_at(
    target: Point,
    *,
    distance: float,
    yaw_deg: float,
    pitch_deg: float,
    view_width: float,
    height: int,
    width: int,
) -> Camera:
    """A camera ``distance`` [m] from ``target``, which it sees in the middle of the picture.

    ``yaw_deg`` moves it to the right around the target, ``pitch_deg`` up; both zero is the frontal view.
    ``view_width`` [m] is what fills the picture's width at the target's distance.
    """
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    ahead = np.array([-np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.array([np.cos(yaw), 0.0, np.sin(yaw)])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    return Camera(rotation, target - distance * ahead, width * distance / view_width, height, width)
