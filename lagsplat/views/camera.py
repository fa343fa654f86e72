"""Pinhole cameras, their arrangement around a scene, and the coordinates of Gaussians in space.

The convention is OpenCV's: camera coordinates have x to the right, y down and z ahead, and a world point is
``R (x - position)`` there. The world of simulated scenes is in metres, x to the right, y down, z away from
the frontal camera: the plane of motion of a planar mechanism is z = 0. Image coordinates follow
`lagsplat.array_types`: the first pixel's centre is (0.5, 0.5).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.views.config import ArrangementConfig

Point = Float64[np.ndarray, "3"]
Homography = Float64[np.ndarray, "3 3"]
ROUNDING = 1e-4  # largest deviation of a rotation from orthonormality: files keep about six digits


@dataclass(frozen=True)
class Camera:
    """Pose and projection of a camera.

    ``rotation`` turns world into camera coordinates, ``position`` is in the world [unit of length].
    ``focal`` and ``middle``, the principal point, are (x, y) [pixel]; ``height`` and ``width`` [pixel].

    Raises:
        ValueError: no rotation matrix, a focal length or size that is not positive, or a number not finite.
    """

    rotation: Float64[np.ndarray, "3 3"]
    position: Point
    focal: tuple[float, float]
    middle: tuple[float, float]
    height: int
    width: int

    def __post_init__(self) -> None:
        turn = self.rotation
        a, b = turn.shape, self.position.shape
        if (a, b) != ((3, 3), (3,)):
            raise ValueError(f"a camera has a rotation of (3, 3) and a position of (3,), not {a} and {b}")
        if not np.isfinite([*turn.flat, *self.position]).all():
            raise ValueError("a camera's pose is not finite; calibrate it again")
        off, determinant = float(np.abs(turn @ turn.T - np.eye(3)).max()), np.linalg.det(turn)
        if off > ROUNDING or determinant < 0:
            raise ValueError(
                f"a camera's rotation is not one: R R^T misses the identity by {off:.2g} and its determinant "
                f"is {determinant:.4g}; give the world-to-camera rotation in OpenCV's axes, determinant 1"
            )
        positive = min(*self.focal, self.height, self.width) > 0
        if not positive or not np.isfinite([*self.focal, *self.middle]).all():
            raise ValueError(
                f"a camera of {self.height} x {self.width} pixels, focal lengths {self.focal} and principal "
                f"point {self.middle}: sizes and focal lengths are positive, in pixels"
            )

    def within(self, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 3"]:
        """World points in camera coordinates; the third is the depth."""
        return (points - self.position) @ self.rotation.T

    def project(self, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 2"]:
        """Image coordinates [pixel] of world points; meaningless for points behind the camera."""
        seen = self.within(points)
        return np.array(self.focal) * seen[:, :2] / seen[:, 2:] + np.array(self.middle)

    def ray(self, pixel: tuple[float, float]) -> Point:
        """World direction of the ray through an image point, scaled to unit depth."""
        ahead = [(at - mid) / focal for at, mid, focal in zip(pixel, self.middle, self.focal, strict=True)]
        return self.rotation.T @ np.array([*ahead, 1.0])

    def resized(self, height: int, width: int) -> "Camera":
        """The same camera at another resolution."""
        across, down = width / self.width, height / self.height
        focal, middle = ((across * x, down * y) for x, y in (self.focal, self.middle))
        return replace(self, focal=focal, middle=middle, height=height, width=width)

    def of_plane(self, origin: Point, right: Point, down: Point) -> Homography:
        """Homography from (a, b, 1) on the plane ``origin + a right + b down`` to image coordinates.

        Source: Hartley and Zisserman, Multiple View Geometry, section 8.1.
        """
        columns = [self.rotation @ right, self.rotation @ down, self.rotation @ (origin - self.position)]
        return self.matrix() @ np.stack(columns, axis=1)

    def matrix(self) -> Float64[np.ndarray, "3 3"]:
        """The intrinsic matrix ``K`` [pixel]."""
        (across, down), (x, y) = self.focal, self.middle
        return np.array([[across, 0, x], [0, down, y], [0, 0, 1.0]])


def project_by_lens(
    points: Float64[np.ndarray, "*N 3"], lens: Sequence[float]
) -> Float64[np.ndarray, "*N 2"]:
    """Image coordinates [pixel] of points in the axes of a camera.

    Args:
        points: in the camera's axes.
        lens: focal lengths and principal point (x, y, x, y) [pixel].
    """
    return np.array(lens[:2]) * points[..., :2] / points[..., 2:] + np.array(lens[2:])


def center_camera(
    rotation: Float64[np.ndarray, "3 3"], position: Point, *, focal: float, height: int, width: int
) -> Camera:
    """A camera with square pixels, focal length [pixel], and the principal point at the image centre."""
    return Camera(rotation, position, (focal, focal), (0.5 * width, 0.5 * height), height, width)


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
    """A camera that sees ``target`` at the image centre, from a ``distance`` [m].

    The angles move it right and up around the target: zero is the frontal view. At the target the view is
    ``view_width`` [m] wide.
    """
    turn = turn_camera(yaw_deg, pitch_deg)
    focal = width * distance / view_width
    return center_camera(turn, target - distance * turn[2], focal=focal, height=height, width=width)


def turn_camera(yaw_deg: float, pitch_deg: float) -> Float64[np.ndarray, "3 3"]:
    """World-to-camera rotation after orbiting right by ``yaw_deg`` and up by ``pitch_deg``."""
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    ahead = np.array([-np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.array([np.cos(yaw), 0.0, np.sin(yaw)])
    return np.stack([right, np.cross(ahead, right), ahead])


def orbit_camera(camera: Camera, depth: float, *, yaw_deg: float, pitch_deg: float) -> Camera:
    """Move ``camera`` right and up around the point ``depth`` ahead of it, which keeps its image point."""
    pivot = camera.position + depth * camera.rotation[2]
    rotation = turn_camera(yaw_deg, pitch_deg) @ camera.rotation
    return replace(camera, rotation=rotation, position=pivot - depth * rotation[2])


BETWEEN = 0.55  # ellipse of the held-out cameras as a share of the extents: between the other cameras
START = 0.4  # angle of the first held-out camera [rad]


@dataclass(frozen=True)
class ViewSpace:
    """Coordinates of Gaussians in space: the axes and origin of the ``reference`` camera.

    The unit of length is what its pixel covers at ``depth`` [unit of the world], where the pivot lies, so
    step sizes in pixels mean the same in the plane and in space.

    Raises:
        ValueError: a depth that is not positive.
    """

    reference: Camera
    depth: float

    def __post_init__(self) -> None:
        if not (self.depth > 0 and np.isfinite(self.depth)):
            raise ValueError(
                f"the pivot is {self.depth} ahead of the reference camera: give a positive depth"
            )

    @property
    def unit(self) -> float:
        """One unit of length, in units of the world."""
        return self.depth / self.reference.focal[0]

    @property
    def pivot(self) -> Point:
        """The world point ahead of the reference camera at the pivot's depth."""
        return self.reference.position + self.depth * self.reference.rotation[2]

    def resized(self, height: int, width: int) -> "ViewSpace":
        """The coordinates for another resolution of the reference camera."""
        return replace(self, reference=self.reference.resized(height, width))

    def seen_by(self, camera: Camera) -> Camera:
        """Convert a camera of the world to these coordinates."""
        rotation = camera.rotation @ self.reference.rotation.T
        return replace(camera, rotation=rotation, position=self.inside(camera.position[None])[0])

    def inside(self, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 3"]:
        """Convert world points to these coordinates."""
        return self.reference.within(points) / self.unit

    def outside(self, points: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 3"]:
        """Convert points of these coordinates to the world."""
        return self.unit * points @ self.reference.rotation + self.reference.position


def arrange_cameras(
    space: ViewSpace, config: ArrangementConfig
) -> tuple[list[Camera], list[str], list[bool]]:
    """Cameras on a grid of yaws and pitches about the pivot, then the held-out ones between them.

    All are the reference camera moved on a sphere about the pivot of ``space``, which keeps its image point.
    Returns cameras, their names and whether each is held out.
    """
    yaws, pitches = _ticks(config.yaw_deg, config.columns), _ticks(config.pitch_deg, config.rows)
    grid = [(yaw, pitch) for pitch in pitches for yaw in yaws]
    turns = START + 2 * np.pi * np.arange(config.held_out) / max(config.held_out, 1)
    yaw, pitch = BETWEEN * config.yaw_deg, BETWEEN * config.pitch_deg
    between = [(yaw * np.cos(turn), pitch * np.sin(turn)) for turn in turns]
    camera, depth, angles = space.reference, space.depth, grid + between
    cameras = [orbit_camera(camera, depth, yaw_deg=yaw, pitch_deg=pitch) for yaw, pitch in angles]
    names = [f"yaw {yaw:+.1f} pitch {pitch:+.1f}" for yaw, pitch in angles]
    return cameras, names, [False] * len(grid) + [True] * len(between)


def _ticks(extent: float, count: int) -> list[float]:
    return np.linspace(-extent, extent, count).tolist() if count > 1 else [0.0]
