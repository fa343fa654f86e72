"""The scene in the browser: the filmed object, the hand's arrow and brush, overlays, the real frame."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser
from jaxtyping import Float64, UInt8

from lagsplat.forces.equilibrium import OperatingPoint
from lagsplat.viewer.rendering.overlays import AccelerationField, draw_lines, to_segments
from lagsplat.viewer.rendering.renderer import ImageRenderer, open_renderer
from lagsplat.viewer.server.canvas import QUALITY, UPRIGHT, CameraCanvas, Canvas, ImageCanvas
from lagsplat.viewer.simulation.session import Session, Snapshot

FORCE, BRUSH, FIELD, RESIDUAL = (240, 84, 0), (255, 255, 255), (120, 230, 150), (240, 90, 200)
CORNERS = 48
LATENCIES = 200
SHORTEST_PX = 0.15
GAP = 1.06
NOTHING = np.zeros((1, 2, 3))


@dataclass
class DisplayOptions:
    """What is laid over the picture."""

    outline: bool = False
    velocity: bool = False
    residual: bool = False
    real: bool = False


class SceneView:
    """Nodes of a viser scene that follow the snapshots of a session.

    ``frame`` gives the recorded picture of a frame; ``residual`` the acceleration of the whitened state
    that a diagnosis found missing, or None.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        board: Canvas,
        *,
        frame: Callable[[int], UInt8[np.ndarray, "H W 3"]],
        residual: Callable[[Snapshot], Float64[np.ndarray, " d"]] | None = None,
    ) -> None:
        held, recorded = session.held, session.recorded
        self.server, self.board, self.frame, self.residual = server, board, frame, residual
        self.touch, self.shown, self.field = session.touch, DisplayOptions(), AccelerationField(held)
        swing = np.abs(recorded.v).max(0) if recorded.frames else np.ones(held.law.d)
        self.fastest = float(np.linalg.norm(self.field.along(swing), axis=1).max(initial=1e-12))
        self.latencies_ms: deque[float] = deque(maxlen=LATENCIES)
        self.measured_s: float | None = None
        scene, (width, height) = server.scene, board.size
        scene.set_up_direction("+y")
        scene.world_axes.visible = False
        blank = np.zeros((held.kinematics.height, held.kinematics.width, 3), np.uint8)
        self.real = scene.add_image("/real", blank, width, height, format="jpeg", jpeg_quality=QUALITY,
                                    cast_shadow=False, receive_shadow=False, visible=False,
                                    position=(GAP * width, 0.0, 0.0), wxyz=UPRIGHT)  # fmt: skip
        self.real_name = scene.add_label("/real/name", "recorded", position=(0.0, 0.54 * height, 0.0),
                                         anchor="top-center", visible=False)  # fmt: skip
        self.arrow = scene.add_arrows("/force", NOTHING.astype(np.float32), FORCE, shaft_radius=0.035,
                                      head_radius=0.091, head_length=0.175, visible=False)  # fmt: skip
        # lines and no arrowheads, which would stay where nothing moves
        self.velocity = draw_lines(scene, "/velocity", NOTHING, FIELD, thick=0.02)
        self.missing = draw_lines(scene, "/residual", NOTHING, RESIDUAL, thick=0.024)
        self.brush = draw_lines(scene, "/brush", NOTHING, BRUSH, thick=0.02)

    def show(self, snapshot: Snapshot) -> None:
        """Draw a snapshot for everyone who looks."""
        self.board.show_rest(self.shown.outline)
        painted = self.board.paint(snapshot.q)
        with self.server.atomic():
            self.board.put(painted)
            self._show_hand(snapshot)
            self._show_overlays(snapshot)
        if snapshot.asked_s is not None and snapshot.asked_s != self.measured_s:
            self.measured_s = snapshot.asked_s
            self.latencies_ms.append(1e3 * (time.perf_counter() - snapshot.asked_s))

    def _show_hand(self, snapshot: Snapshot) -> None:
        hand = snapshot.hand
        self.arrow.visible = self.brush.visible = hand is not None
        if hand is None:
            return
        place = hand.place(snapshot.q)
        self.brush.points = draw_ring(self.board, place, self.touch.radius_px)
        tip = place + hand.force / self.touch.gain
        self.arrow.visible = bool(np.linalg.norm(tip - place) > SHORTEST_PX)
        self.arrow.points = self.board.over(np.stack([place, tip])[None], layer=2).astype(np.float32)

    def _show_overlays(self, snapshot: Snapshot) -> None:
        shown = self.shown
        self.velocity.visible = shown.velocity
        self.real.visible = self.real_name.visible = shown.real and snapshot.frame is not None
        self.missing.visible = shown.residual and self.residual is not None
        if self.velocity.visible:
            self.velocity.points = self._drawn(snapshot.q, snapshot.v, self.fastest)
        if self.missing.visible and self.residual is not None:
            rate = self.residual(snapshot)
            largest = float(np.linalg.norm(self.field.along(rate), axis=1).max(initial=1e-12))
            self.missing.points = self._drawn(snapshot.q, rate, largest)
        if self.real.visible and snapshot.frame is not None:
            self.real.image = self.frame(snapshot.frame)

    def _drawn(self, q: np.ndarray, rate: np.ndarray, largest: float) -> np.ndarray:
        arrows = self.field.arrows(q, rate, largest=largest)
        return self.board.over(arrows).astype(np.float32)


def open_canvas(server: viser.ViserServer, held: OperatingPoint, *, side: int, window: int) -> Canvas:
    """The board that suits where a run's Gaussians live: a sheet of ``side``, or windows of ``window`` px."""
    easel = open_renderer(held.autoencoder, held.chart, side=side)
    if isinstance(easel, ImageRenderer):
        return ImageCanvas(server, held, easel)
    return CameraCanvas(server, held, easel, side=window)


def draw_ring(board: Canvas, middle: Float64[np.ndarray, " n"], radius_px: float) -> np.ndarray:
    """A circle around ``middle`` as segments of the scene, in the plane of the latest drag."""
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS)
    circle = middle + radius_px * (np.stack([np.cos(angle), np.sin(angle)], axis=1) @ board.axes)
    return to_segments(board.over(circle)).astype(np.float32)
