"""Overlays of the live view: drag proxies, the outline at rest, and arrows of velocity or acceleration."""

import numpy as np
import torch
import viser
from jaxtyping import Bool, Float64, Int64
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull, KDTree
from scipy.spatial.transform import Rotation
from skimage.measure import find_contours
from torch import Tensor

from lagsplat.array_types import Vector
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.forces.rest_outline import draw_rest_mask
from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.projection import SQUARE
from lagsplat.viewer.rendering.renderer import SceneRenderer
from lagsplat.viewer.rendering.scene_frame import SceneFrame
from lagsplat.views.camera import Camera
from lagsplat.views.novel import cameras_bytes


def draw_lines(
    scene: viser.SceneApi, name: str, points: np.ndarray, color: tuple[int, int, int], *, thick: float
) -> viser.LineSegmentsHandle:
    """Add hidden line segments (N, 2, 3) to a scene; ``thick`` is in its unit."""
    return scene.add_line_segments(name, points.astype(np.float32), color, thickness=thick, visible=False)


def to_segments(line: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "m 2 k"]:
    """Split a polyline into its segments."""
    return np.stack([line[:-1], line[1:]], axis=1)


REST = (64, 196, 255)  # colour of the outline at rest
OPAQUE = 0.3  # opacity at the boundary of a drag proxy
MOST = 1200  # number of Gaussians that a browser keeps track of; the largest are taken
NOWHERE = 1e-4  # half axis of a faded proxy [px]; a browser does not draw a scale of zero
STATES = 16  # recorded states at which the opacity of the Gaussians is checked
NEAR_PX = 2.0  # largest distance of a Gaussian of matter from a material point: these are a pixel apart


class DragProxies:
    """Ellipsoids on the Gaussians that are ``of_matter`` (K,) and visible in the recording.

    Those of matter have their centre within `NEAR_PX` of a material point at rest, so that a press on one
    grasps matter.
    """

    def __init__(self, operating_point: OperatingPoint) -> None:
        self.model, self.chart = operating_point.autoencoder.gaussians, operating_point.chart
        rest, states = operating_point.rest.numpy(), self.chart.train.latents
        rows = np.linspace(0, len(states) - 1, min(STATES, len(states))).astype(int)
        drawn = self._condition(np.concatenate([rest[None], states[rows]]))
        values, vectors = np.linalg.eigh(drawn.covariance[:, SQUARE].double().unflatten(1, (3, 3)).numpy())
        sigma = np.sqrt(np.clip(values, 0.0, None))
        points = operating_point.matter.carry(operating_point.rest[None])[0].numpy()
        self.of_matter = torch.from_numpy(KDTree(points).query(drawn.means[0].numpy())[0] <= NEAR_PX)
        visible = drawn.opacity.amax(0) > OPAQUE
        size = torch.from_numpy(sigma[:, 1:].prod(1)) * (self.of_matter & visible)
        order = size.argsort(descending=True)[:MOST]
        self.chosen = order[size[order] > 0].sort().values
        self.sigma = sigma[self.chosen.numpy()]
        # eigenvectors may form a reflection; a sign makes it a rotation
        axes = vectors[self.chosen.numpy()]
        self.axes = axes * np.sign(np.linalg.det(axes))[:, None, None]

    def orientations(self, flip: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "K 4"]:
        """Orientations (w, x, y, z) of the ellipsoids in the coordinates of the run times ``flip``."""
        return Rotation.from_matrix(flip[:, None] * self.axes).as_quat(scalar_first=True)

    def ellipsoids(self, q: Vector) -> tuple[np.ndarray, np.ndarray]:
        """Centres and half axes (K, 3) [px at the pivot] at a whitened state; tiny axes where faded."""
        drawn = self._condition(q[None])
        opacity = drawn.opacity[0, self.chosen].double().numpy()
        ends = np.sqrt(2.0 * np.log(np.maximum(opacity / OPAQUE, 1.0)))
        place = drawn.means[0, self.chosen].double().numpy()
        return place, np.maximum(ends[:, None] * self.sigma, NOWHERE)

    @torch.no_grad()
    def _condition(self, q: Float64[np.ndarray, "B d"]) -> GaussianSlice:
        raw = torch.from_numpy(self.chart.to_raw(q)).to(self.model.center)
        return GaussianSlice(*(part.cpu() for part in self.model.condition(raw)))


def make_ball() -> tuple[Float64[np.ndarray, "12 3"], Int64[np.ndarray, "20 3"]]:
    """Corners and triangles of an icosahedron inscribed in the unit ball."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array([(0.0, a, b * golden) for a in (-1, 1) for b in (-1, 1)])
    corners = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    corners /= np.linalg.norm(corners[0])
    return corners, ConvexHull(corners).simplices.astype(np.int64)


CELLS = 14  # cells along the longer side of the image; each has at most one arrow
FINER = 2  # multiple of the training resolution at which the outline is traced
SHORT = 12  # outlines of at most as many corners are specks


def trace_rest_outline(operating_point: OperatingPoint) -> list[Float64[np.ndarray, "n 2"]]:
    """Trace the outlines of the object at rest [px of the training resolution]."""
    mask = draw_rest_mask(operating_point, scale=FINER)
    return [line / FINER for line in trace_outlines(mask.astype(np.float64), smooth_px=float(FINER))]


def trace_outlines(share: Float64[np.ndarray, "H W"], *, smooth_px: float) -> list[np.ndarray]:
    """Trace where a smoothed mask crosses one half, as polylines of corners (x, y) [px]."""
    smooth = np.pad(gaussian_filter(share, smooth_px), 1)
    return [line[:, ::-1] - 0.5 for line in find_contours(smooth, 0.5) if len(line) > SHORT]


class AccelerationField:
    """Arrows on the matter: one per image cell, on the material point that moves most there."""

    def __init__(self, operating_point: OperatingPoint) -> None:
        matter, rest = operating_point.matter, operating_point.rest
        height, width = operating_point.height, operating_point.width
        places = matter.carry(rest[None])[0].numpy()
        self.cell = max(height, width) / CELLS
        order = matter.jacobian(rest).flatten(1).norm(dim=1).argsort(descending=True).numpy()
        if matter.space == 2:
            outside = np.any((places < 0.0) | (places >= (width, height)), axis=1)
            order = order[~outside[order]]
        _, first = np.unique((places[order] // self.cell).astype(int), axis=0, return_index=True)
        self.chosen = torch.from_numpy(np.sort(order[first]))
        self.points = matter.every[self.chosen]

    def along(self, q: Vector, rate: Vector) -> Float64[np.ndarray, "n k"]:
        """Motion of the matter at the feet for a rate of the state ``q`` [px per unit of the rate]."""
        return self.points.jacobian(torch.from_numpy(q)).numpy() @ rate

    def largest(self, q: Vector, rate: Vector) -> float:
        """The largest of these motions, never zero."""
        return float(np.linalg.norm(self.along(q, rate), axis=1).max(initial=1e-12))

    def arrows(self, q: Vector, rate: Vector, *, largest: float) -> Float64[np.ndarray, "n 2 k"]:
        """Feet and tips [px]; a motion of ``largest`` [px per unit] is drawn two cells long."""
        feet = self.points.carry(torch.from_numpy(q)[None])[0].numpy()
        ways = self.along(q, rate) * (2.0 * self.cell / max(largest, 1e-12))
        return np.stack([feet, feet + ways], axis=1)


COARSE = 2  # pixels of a visitor's image per pixel of the mask that is outlined, each way
SMOOTH_PX = 0.7  # width of the filter on the mask
THICK = 0.014  # thickness of the outline in the unit of the scene, at the distance of the recording camera


class Silhouettes:
    """Outlines of the object at the state ``rest``, one for each visitor.

    An outline lies in the plane through the pivot parallel to the visitor's image, so that it stays on the
    object until the camera moves.
    """

    def __init__(
        self, renderer: SceneRenderer, scene_frame: SceneFrame, of_matter: Bool[Tensor, " K"], rest: Vector
    ) -> None:
        self.renderer, self.scene_frame, self.rest = renderer, scene_frame, rest
        self.white = of_matter[:, None].expand(-1, 3).to(torch.float32)
        self.handles: dict[int, viser.LineSegmentsHandle] = {}
        self.drawn_keys: dict[int, bytes] = {}

    def update(self, client: viser.ClientHandle, camera: Camera) -> None:
        """Show a visitor the outline seen from ``camera``; trace it anew if this is another one."""
        number, key = client.client_id, cameras_bytes([camera])
        if number not in self.handles:
            self.handles[number] = draw_lines(client.scene, "/rest", np.zeros((1, 2, 3)), REST, thick=THICK)
        if self.drawn_keys.get(number) != key:
            self.drawn_keys[number] = key
            self.handles[number].points = self.scene_frame.to_scene(self.trace(camera)).astype(np.float32)
        self.handles[number].visible = True

    def hide(self) -> None:
        """Hide the outline from everyone."""
        for handle in self.handles.values():
            handle.visible = False

    def forget(self, client_id: int) -> None:
        """Drop the data of a visitor who has left."""
        self.handles.pop(client_id, None)
        self.drawn_keys.pop(client_id, None)

    def trace(self, camera: Camera) -> Float64[np.ndarray, "N 2 3"]:
        """Trace the outline seen from ``camera`` as segments in space (N, 2, 3)."""
        coarse = camera.resized(max(1, camera.height // COARSE), max(1, camera.width // COARSE))
        mask = self.renderer.render_view(self.rest, coarse, color=self.white)[:, :, 0] / 255.0
        lines = [to_segments(line) for line in trace_outlines(mask, smooth_px=SMOOTH_PX)]
        pixels = np.concatenate(lines or [np.zeros((1, 2, 2))])
        ahead = (pixels - np.array(coarse.middle)) / np.array(coarse.focal)
        depth = float(np.linalg.norm(self.scene_frame.pivot - camera.position))
        inside = depth * np.concatenate([ahead, np.ones_like(ahead[..., :1])], axis=-1)
        return camera.position + inside @ camera.rotation
