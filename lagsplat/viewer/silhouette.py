"""The outline of the object at rest in space, as each visitor sees it."""

import numpy as np
import torch
import viser
from jaxtyping import Bool, Float64
from torch import Tensor

from lagsplat.viewer.board import lines, segments
from lagsplat.viewer.easel import SpaceEasel
from lagsplat.viewer.overlay import outlines
from lagsplat.viewer.room import Room
from lagsplat.viewer.sheet import REST
from lagsplat.views.camera import Camera

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
        self, easel: SpaceEasel, room: Room, moves: Bool[Tensor, " K"], rest: Float64[np.ndarray, " d"]
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
            handle = self.handles[client.client_id] = lines(client.scene, "/rest", empty, REST, thick=THICK)
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
        found = [segments(line) for line in outlines(mask, smooth_px=SMOOTH_PX)]
        pixels = np.concatenate(found or [np.zeros((1, 2, 2))])
        ahead = (pixels - np.array(small.middle)) / np.array(small.focal)
        depth = float(np.linalg.norm(self.room.pivot - camera.position))
        inside = depth * np.concatenate([ahead, np.ones_like(ahead[..., :1])], axis=-1)
        return camera.position + inside @ camera.rotation
