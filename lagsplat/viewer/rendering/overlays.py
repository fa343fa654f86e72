"""A run whose Gaussians live in space: every visitor looks from a side of their own.

The matter that a pointer in space can take hold of: where the Gaussians that move stop light.

What can be laid over the picture: where the object rests, and how its matter moves or is pushed.

The outline of the object at rest in space, as each visitor sees it.
"""

import numpy as np
import torch
import viser
from jaxtyping import Bool, Float64, Int64
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull, KDTree
from scipy.spatial.transform import Rotation
from skimage.measure import find_contours
from torch import Tensor

from lagsplat.forces.equilibrium import OperatingPoint
from lagsplat.forces.grasp import MatterKinematics
from lagsplat.forces.moving_parts import draw_outline, find_moving_parts
from lagsplat.splat.projection import SQUARE
from lagsplat.viewer.rendering.renderer import SceneRenderer
from lagsplat.viewer.rendering.scene_frame import SceneFrame
from lagsplat.views.camera import Camera


def draw_lines(
    scene: viser.SceneApi, name: str, points: np.ndarray, color: tuple[int, int, int], *, thick: float
) -> viser.LineSegmentsHandle:
    """Hidden line segments (N, 2, 3) of a scene, as thick as told in its unit."""
    return scene.add_line_segments(name, points.astype(np.float32), color, thickness=thick, visible=False)


def to_segments(line: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "m 2 k"]:
    """A line through corners as segments."""
    return np.stack([line[:-1], line[1:]], axis=1)


REST = (64, 196, 255)


OPAQUE = 0.3
"""Of the light: a Gaussian is taken to end where it stops less by itself."""
MOST = 1200
"""Gaussians that a browser is asked to keep track of; the largest are taken."""
NOWHERE = 1e-4
STATES = 16


class DragProxies:
    """Ellipsoids on the Gaussians that move and are seen somewhere on the way, in the run's coordinates.

    ``moves`` (K,) says which of the decoder's Gaussians move at all.
    """

    def __init__(self, held: OperatingPoint) -> None:
        self.kinematics = held.kinematics
        seen = self._presence_on_the_way(held)
        with torch.no_grad():
            covariance = held.autoencoder.gaussians.covariance().cpu().double()
        values, vectors = np.linalg.eigh(covariance[:, SQUARE].unflatten(1, (3, 3)).numpy())
        sigma = np.sqrt(np.clip(values, 0.0, None))
        self.moves = torch.from_numpy(select_moving(self.kinematics))
        size = torch.from_numpy(sigma[:, 1:].prod(1)) * (self.moves & (seen > OPAQUE))
        order = size.argsort(descending=True)[:MOST]
        self.chosen = order[size[order] > 0].sort().values
        self.sigma = sigma[self.chosen.numpy()]
        # a rotation, where the eigenvectors may also be a reflection
        axes = vectors[self.chosen.numpy()]
        self.axes = axes * np.sign(np.linalg.det(axes))[:, None, None]

    def turned(self, flip: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "K 4"]:
        """Orientations (w, x, y, z) of the ellipsoids in coordinates that are ``flip`` times the run's."""
        return Rotation.from_matrix(flip[:, None] * self.axes).as_quat(scalar_first=True)

    def at(
        self, q: Float64[np.ndarray, " d"]
    ) -> tuple[Float64[np.ndarray, "K 3"], Float64[np.ndarray, "K 3"]]:
        """Centres and half axes [px at the pivot] at a whitened state; half axes of what is faded vanish."""
        state = torch.from_numpy(q)[None]
        place = self.kinematics.places(state)[0, self.chosen].numpy()
        present = self.kinematics.presence(state)[0, self.chosen].numpy()
        ends = np.sqrt(2.0 * np.log(np.maximum(present / OPAQUE, 1.0)))
        return place, np.maximum(ends[:, None] * self.sigma, NOWHERE)

    def _presence_on_the_way(self, held: OperatingPoint) -> torch.Tensor:
        states = held.chart.train.latents
        rows = np.linspace(0, len(states) - 1, min(STATES, len(states))).astype(int)
        visited = torch.cat([held.rest[None], torch.from_numpy(states[rows])])
        return self.kinematics.presence(visited).amax(0)


def make_ball() -> tuple[Float64[np.ndarray, "12 3"], Int64[np.ndarray, "20 3"]]:
    """Corners and triangles of an icosahedron around the unit ball's middle, with its corners on it."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array([(0.0, a, b * golden) for a in (-1, 1) for b in (-1, 1)])
    corners = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    corners /= np.linalg.norm(corners[0])
    return corners, ConvexHull(corners).simplices.astype(np.int64)


CELLS = 14
"""Cells along the longer side of the picture in each of which one arrow stands."""
PRESENT = 0.2
MOVES = 0.1
"""Of the largest motion: what moves less is ground, gets no arrow and in space cannot be dragged."""
LARGEST = 0.98
COMPANY = 4
STRAY = 3.0
"""Of the usual distance to the fourth neighbour that moves: what is further from its own is alone."""
FINER = 2
"""Times the training resolution at which the outline is cut."""
SHORT = 12
"""Corners: specks have fewer."""


def trace_rest_outline(held: OperatingPoint) -> list[Float64[np.ndarray, "n 2"]]:
    """Outlines [px of the training resolution] of the object where it rests."""
    rest = held.rest[None]
    seen = draw_outline(
        held.pictures(rest, scale=FINER)[0], find_moving_parts(held.autoencoder, held.chart, rest[0].numpy())
    )
    return [line / FINER for line in trace_outlines(seen.astype(np.float64), smooth_px=float(FINER))]


def trace_outlines(
    share: Float64[np.ndarray, "H W"], *, smooth_px: float
) -> list[Float64[np.ndarray, "n 2"]]:
    """Where a picture crosses one half, smoothed, as lines through corners (x, y) [px]."""
    smooth = np.pad(gaussian_filter(share, smooth_px), 1)
    return [line[:, ::-1] - 0.5 for line in find_contours(smooth, 0.5) if len(line) > SHORT]


def select_moving(kinematics: MatterKinematics) -> Bool[np.ndarray, " K"]:
    """Which Gaussians move and are neither ground nor stray: a few that hang about alone help a decoder to
    reach the last decimal, but belong to no object.
    """
    motion = kinematics.geometry.jacobian.flatten(1).norm(dim=1).numpy()
    moves = motion >= MOVES * np.quantile(motion, LARGEST)
    if moves.sum() > COMPANY:
        centers = kinematics.center[torch.from_numpy(moves)].numpy()
        away = KDTree(centers).query(centers, COMPANY + 1)[0][:, -1]
        moves[moves] = away <= STRAY * np.median(away)
    return moves


class AccelerationField:
    """Arrows on the matter: one Gaussian a cell, the one most present, followed along its own Jacobian."""

    def __init__(self, held: OperatingPoint) -> None:
        kinematics = held.kinematics
        places = kinematics.places(held.rest[None])[0].numpy()
        present = kinematics.presence(held.rest[None])[0].numpy()
        motion = kinematics.geometry.jacobian.flatten(1).norm(dim=1).numpy()
        cell = max(kinematics.height, kinematics.width) / CELLS
        usable = select_moving(kinematics) & (present > PRESENT)
        if kinematics.space == 2:
            usable &= ((places >= 0.0) & (places < (kinematics.width, kinematics.height))).all(1)
        best: dict[tuple[int, ...], int] = {}
        for i in np.argsort(present * motion):  # the last one written is the one that tells most
            if usable[i]:
                best[tuple((places[i] // cell).astype(int).tolist())] = int(i)
        self.chosen = torch.tensor(sorted(best.values()), dtype=torch.long)
        self.kinematics, self.cell = kinematics, cell
        self.jacobian = kinematics.geometry.jacobian[self.chosen].numpy()

    def places(self, q: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, "n k"]:
        """Feet of the arrows [px]."""
        return self.kinematics.places(torch.from_numpy(q)[None])[0, self.chosen].numpy()

    def along(self, rate: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, "n k"]:
        """What a rate of the state is to the matter at the feet [px per its unit]."""
        return self.jacobian @ rate

    def arrows(
        self, q: Float64[np.ndarray, " d"], rate: Float64[np.ndarray, " d"], *, largest: float
    ) -> Float64[np.ndarray, "n 2 k"]:
        """Feet and tips [px]; ``largest`` is the length [px per unit] drawn two cells long."""
        feet = self.places(q)
        return np.stack([feet, feet + self.along(rate) * (2.0 * self.cell / max(largest, 1e-12))], axis=1)


COARSE = 2
"""Pixels of a visitor's picture, each way, to one of the mask that is outlined."""
SMOOTH_PX = 0.7
THICK = 0.014
"""Of the outline, in the scene at the distance of the film's camera."""


class Silhouettes:
    """Outlines of what moves where it is seen at the state ``rest``: one a visitor, hung before each at the
    pivot's distance, so that it keeps its place on the screen until the camera moves.
    """

    def __init__(
        self,
        easel: SceneRenderer,
        room: SceneFrame,
        moves: Bool[Tensor, " K"],
        rest: Float64[np.ndarray, " d"],
    ) -> None:
        self.easel, self.room, self.rest = easel, room, rest
        self.white = moves[:, None].expand(-1, 3).to(torch.float32)
        self.handles: dict[int, viser.LineSegmentsHandle] = {}
        self.seen: dict[int, bytes] = {}

    def put(self, client: viser.ClientHandle, camera: Camera, look: bytes) -> None:
        """Show one visitor the outline from this camera, of which ``look`` tells one from another."""
        handle = self.handles.get(client.client_id)
        if handle is None:
            empty = np.zeros((1, 2, 3))
            handle = self.handles[client.client_id] = draw_lines(
                client.scene, "/rest", empty, REST, thick=THICK
            )
        if self.seen.get(client.client_id) != look:
            self.seen[client.client_id] = look
            handle.points = self.room.to_scene(self.outline(camera)).astype(np.float32)
        handle.visible = True

    def hide(self) -> None:
        """Show it to no one."""
        for handle in self.handles.values():
            handle.visible = False

    def forget(self, who: int) -> None:
        """A visitor has left."""
        self.handles.pop(who, None)
        self.seen.pop(who, None)

    def outline(self, camera: Camera) -> Float64[np.ndarray, "N 2 3"]:
        """Segments in space, on the plane before a camera at its distance from the pivot."""
        small = camera.resized(max(1, camera.height // COARSE), max(1, camera.width // COARSE))
        mask = self.easel.seen(self.rest, small, color=self.white)[:, :, 0] / 255.0
        found = [to_segments(line) for line in trace_outlines(mask, smooth_px=SMOOTH_PX)]
        pixels = np.concatenate(found or [np.zeros((1, 2, 2))])
        ahead = (pixels - np.array(small.middle)) / np.array(small.focal)
        depth = float(np.linalg.norm(self.room.pivot - camera.position))
        inside = depth * np.concatenate([ahead, np.ones_like(ahead[..., :1])], axis=-1)
        return camera.position + inside @ camera.rotation
