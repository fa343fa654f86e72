"""The scene in the browser: the object, the arrow and brush of a grasp, overlays and the recorded frame."""

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from lagsplat.array_types import Vector
from lagsplat.forces.answer_spread import NINE_IN_TEN
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.viewer.rendering.overlays import AccelerationField, draw_lines, to_segments
from lagsplat.viewer.rendering.renderer import FrameRenderer, ImageRenderer, RgbImage
from lagsplat.viewer.server.canvas import CameraCanvas, Canvas, ImageCanvas, add_image
from lagsplat.viewer.simulation.session import Session, Snapshot

FORCE, BRUSH, FIELD, RESIDUAL = (240, 84, 0), (255, 255, 255), (120, 230, 150), (240, 90, 200)
WARNING = (255, 150, 60)
RIM = 0.05  # thickness of the frame around the picture of a state beyond the recording
HINT = "Drag the object, or press an arrow key"
HINT_WAY = 0.3  # length of the drag that the hint shows, over the height of the image
CORNERS = 48  # corners of the circle that shows the brush
LATENCIES = 200  # latest drags over which the latency is measured
SHORTEST_PX = 0.15  # arrows that are shorter are hidden
GAP = 1.06  # distance of the recorded frame from the image, in widths of the image
EMPTY = np.zeros((1, 2, 3), np.float32)


OVERLAYS = {
    "outline": "Outline at rest",
    "velocity": "Velocity field",
    "recorded": "Recorded frame beside",
    "residual": "Residual of the diagnosis",
}
"""What can be shown besides the object, with its label."""


ReadFrame = Callable[[int], RgbImage]  # reads a recorded frame
Residual = Callable[[Snapshot], Vector] | None  # the acceleration that a diagnosis found missing


class SceneView:
    """The nodes of a viser scene, updated with the snapshots of a session; ``shown`` names overlays."""

    def __init__(
        self, session: Session, canvas: Canvas, *, read_frame: ReadFrame, residual: Residual
    ) -> None:
        operating_point, server = session.operating_point, canvas.server
        self.server, self.canvas, self.read_frame, self.residual = server, canvas, read_frame, residual
        self.grasp_model, self.field = session.grasp_model, AccelerationField(operating_point)
        self.shown = dict.fromkeys(OVERLAYS, False)
        fastest = np.abs(session.recorded.v).max(0)
        self.fastest = self.field.largest(operating_point.rest.numpy(), fastest)
        self.latencies_ms: deque[float] = deque(maxlen=LATENCIES)
        self.measured_s: float | None = None
        scene, (width, height) = server.scene, canvas.size
        scene.set_up_direction("+y")
        scene.world_axes.visible = False
        blank = np.zeros((operating_point.height, operating_point.width, 3), np.uint8)
        self.recorded_image = add_image(scene, "/real", blank, canvas.size, left=GAP * width)
        above = (0.0, 0.54 * height, 0.0)
        self.recorded_label = scene.add_label("/real/name", "recorded", anchor="top-center", position=above)
        self.recorded_image.visible = self.recorded_label.visible = False
        self.arrow = scene.add_arrows("/force", EMPTY, FORCE, shaft_radius=0.035, visible=False)
        self.arrow.head_radius, self.arrow.head_length = 0.091, 0.175
        # lines have no heads, which would stay visible where nothing moves
        self.velocity = draw_lines(scene, "/velocity", EMPTY, FIELD, thick=0.02)
        self.residual_lines = draw_lines(scene, "/residual", EMPTY, RESIDUAL, thick=0.024)
        self.brush = draw_lines(scene, "/brush", EMPTY, BRUSH, thick=0.02)
        self.spread = draw_lines(scene, "/spread", EMPTY, BRUSH, thick=0.012)
        corners = 0.5 * np.array([(-width, -height), (width, -height), (width, height), (-width, height)])
        rim = np.pad(np.concatenate([corners, corners[:1]]), ((0, 0), (0, 1)))
        self.beyond = draw_lines(scene, "/beyond", to_segments(rim), WARNING, thick=RIM)
        self.hint = scene.add_arrows("/hint", self._point_at_lever(operating_point), BRUSH, shaft_radius=0.02)
        self.hint.head_radius, self.hint.head_length = 0.07, 0.14
        below = (0.0, -0.54 * height, 0.0)
        self.hint_words = scene.add_label("/hint-words", HINT, anchor="bottom-center", position=below)

    def draw(self, snapshot: Snapshot) -> None:
        """Draw a snapshot for every visitor."""
        self.canvas.show_rest(self.shown["outline"])
        painted: Any = self.canvas.paint(snapshot.q)
        with self.server.atomic():
            self.canvas.send(painted)
            self._draw_grasp(snapshot)
            self._draw_overlays(snapshot)
        if snapshot.requested_s is not None and snapshot.requested_s != self.measured_s:
            self.measured_s = snapshot.requested_s
            self.latencies_ms.append(1e3 * (time.perf_counter() - snapshot.requested_s))

    def _draw_grasp(self, snapshot: Snapshot) -> None:
        grasp = snapshot.active_grasp
        if grasp is not None and self.hint.visible:
            self.hint.visible = self.hint_words.visible = False  # whoever has pushed knows how
        self.arrow.visible = self.brush.visible = self.spread.visible = grasp is not None
        if grasp is None:
            return
        place, axes = grasp.place(snapshot.q), self.canvas.axes
        angle = np.linspace(0.0, 2.0 * np.pi, CORNERS)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        values, vectors = np.linalg.eigh(axes @ grasp.covariance @ axes.T)
        half = vectors * np.sqrt(NINE_IN_TEN * np.clip(values, 0.0, None))
        for line, ring in ((self.brush, self.grasp_model.radius_px * circle), (self.spread, circle @ half.T)):
            line.points = to_segments(self.canvas.to_scene(place + ring @ axes)).astype(np.float32)
        self.spread.visible = float(np.linalg.norm(half)) > SHORTEST_PX
        tip = place + grasp.force / grasp.gain
        self.arrow.visible = bool(np.linalg.norm(tip - place) > SHORTEST_PX)
        self.arrow.points = self.canvas.to_scene(np.stack([place, tip])[None], layer=2).astype(np.float32)

    def _draw_overlays(self, snapshot: Snapshot) -> None:
        frame = snapshot.frame if self.shown["recorded"] else None
        residual = self.residual if self.shown["residual"] else None
        self.velocity.visible = self.shown["velocity"]
        self.beyond.visible = snapshot.is_beyond
        self.recorded_image.visible = self.recorded_label.visible = frame is not None
        self.residual_lines.visible = residual is not None
        if self.velocity.visible:
            self.velocity.points = self._arrows(snapshot.q, snapshot.v, self.fastest)
        if residual is not None:
            rate = residual(snapshot)
            self.residual_lines.points = self._arrows(snapshot.q, rate, self.field.largest(snapshot.q, rate))
        if frame is not None:
            self.recorded_image.image = self.read_frame(frame)

    def _point_at_lever(self, operating_point: OperatingPoint) -> np.ndarray:
        """Foot and tip of the drag that the hint shows: at the place that moves most, along its way."""
        at, along = operating_point.find_lever()
        foot = operating_point.follow_matter_at(at, operating_point.rest.numpy())
        way = np.pad(np.array(along), (0, len(foot) - 2)) * HINT_WAY * operating_point.height
        return self.canvas.to_scene(np.stack([foot, foot + way])[None], layer=2).astype(np.float32)

    def _arrows(self, q: np.ndarray, rate: np.ndarray, largest: float) -> np.ndarray:
        arrows = self.field.arrows(q, rate, largest=largest)
        return self.canvas.to_scene(arrows).astype(np.float32)


def open_canvas(
    server: viser.ViserServer, operating_point: OperatingPoint, renderer: FrameRenderer, *, window: int
) -> Canvas:
    """Open the canvas for a run: one image, or in space one of ``window`` px for each visitor."""
    if isinstance(renderer, ImageRenderer):
        return ImageCanvas(server, operating_point, renderer)
    return CameraCanvas(server, operating_point, renderer, window)
