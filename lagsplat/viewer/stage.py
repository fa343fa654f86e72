"""The scene in the browser: the picture, the hand's arrow and brush, overlays, and the real frame beside."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser
from jaxtyping import Float64, UInt8

from lagsplat.viewer.easel import Easel
from lagsplat.viewer.overlay import Field, rest_outline
from lagsplat.viewer.plane import Plane
from lagsplat.viewer.session import Session, Snapshot

PICTURE = "/picture"
FRONT = 0.02  # what is drawn over the picture stands this far before it
QUALITY = 90
FORCE, BRUSH, REST, FIELD, RESIDUAL = (
    (240, 84, 0),
    (255, 255, 255),
    (64, 196, 255),
    (120, 230, 150),
    (240, 90, 200),
)
CORNERS = 48
SHORTEST_PX = 0.15
GAP = 1.06
FOV = 0.75
UPRIGHT = (0.0, 1.0, 0.0, 0.0)  # viser hangs the rows of a picture along +y


@dataclass
class Shown:
    """What is laid over the picture."""

    outline: bool = False
    velocity: bool = False
    residual: bool = False
    real: bool = False


class Stage:
    """Nodes of a viser scene that follow the snapshots of a session.

    ``frame`` gives the recorded picture of a frame; ``residual`` the acceleration of the whitened state
    that a diagnosis found missing, or None.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        easel: Easel,
        *,
        frame: Callable[[int], UInt8[np.ndarray, "H W 3"]],
        residual: Callable[[Snapshot], Float64[np.ndarray, " d"]] | None = None,
    ) -> None:
        held = session.held
        self.server, self.easel, self.frame, self.residual = server, easel, frame, residual
        self.plane = Plane(held.kinematics.width, held.kinematics.height)
        self.touch, self.shown, self.field = session.touch, Shown(), Field(held)
        swing = np.abs(session.recorded.v).max(0) if session.recorded.frames else np.ones(held.law.d)
        self.fastest = float(np.linalg.norm(self.field.along(swing), axis=1).max(initial=1e-12))
        self.latencies_ms: list[float] = []
        self._place_camera()
        scene, (width, height) = server.scene, self.plane.size
        blank = easel.draw(held.rest.numpy())
        self.picture = scene.add_image(PICTURE, blank, width, height, format="jpeg", jpeg_quality=QUALITY,
                                       cast_shadow=False, receive_shadow=False, wxyz=UPRIGHT)  # fmt: skip
        self.real = scene.add_image("/real", blank, width, height, format="jpeg", jpeg_quality=QUALITY,
                                    cast_shadow=False, receive_shadow=False, visible=False,
                                    position=(GAP * width, 0.0, 0.0), wxyz=UPRIGHT)  # fmt: skip
        self.real_name = scene.add_label("/real/name", "recorded", position=(0.0, 0.54 * height, 0.0),
                                         anchor="top-center", visible=False)  # fmt: skip
        self.arrow = self._arrows("/force", FORCE, thick=0.035)
        # lines and no arrowheads, which would stay where nothing moves
        self.velocity = self._lines("/velocity", np.zeros((1, 2, 3)), FIELD, thick=0.02)
        self.missing = self._lines("/residual", np.zeros((1, 2, 3)), RESIDUAL, thick=0.024)
        self.brush = self._lines("/brush", ring(self.plane, np.zeros(2), 1.0), BRUSH, thick=0.02)
        lines = [_segments(self.plane.to_scene(line, lift=FRONT)) for line in rest_outline(held)]
        self.rest = self._lines("/rest", np.concatenate(lines or [np.zeros((1, 2, 3))]), REST, thick=0.014)

    def on_drag(
        self, act: Callable[[str, Float64[np.ndarray, "2"], Float64[np.ndarray, "2"], int], None]
    ) -> None:
        """Call ``act`` with the phase (start, update, end), press and pointer [px], and who drags.

        viser delivers about 20 updates a second of a drag on a node, and an end when its tab is closed.
        """

        @self.picture.on_drag("left")
        async def _(event: viser.SceneNodeDragEvent) -> None:  # async: phases arrive in their order
            eye = tuple(event.client.camera.position)
            try:
                press = self.plane.to_pixels(event.start_position, eye=eye)
                pointer = self.plane.to_pixels(event.end_position, eye=eye)
            except ValueError:
                press = pointer = np.full(2, np.nan)
            act(event.phase, press, pointer, event.client_id)

    def show(self, snapshot: Snapshot) -> None:
        """Draw a snapshot for everyone who looks."""
        picture = self.easel.draw(snapshot.q)
        with self.server.atomic():
            self.picture.image = picture
            self._show_hand(snapshot)
            self._show_overlays(snapshot)
        if snapshot.asked_s is not None:
            self.latencies_ms = [*self.latencies_ms[-199:], 1e3 * (time.perf_counter() - snapshot.asked_s)]

    def _show_hand(self, snapshot: Snapshot) -> None:
        hand = snapshot.hand
        self.arrow.visible = self.brush.visible = hand is not None
        if hand is None:
            return
        place = hand.place(snapshot.q)
        self.brush.points = ring(self.plane, place, self.touch.radius_px)
        tip = place + hand.force / self.touch.gain
        self.arrow.visible = bool(np.linalg.norm(tip - place) > SHORTEST_PX)
        self.arrow.points = self.plane.to_scene(np.stack([place, tip])[None], lift=2 * FRONT).astype(
            np.float32
        )

    def _show_overlays(self, snapshot: Snapshot) -> None:
        shown = self.shown
        self.rest.visible, self.velocity.visible = shown.outline, shown.velocity
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
        return self.plane.to_scene(arrows, lift=FRONT).astype(np.float32)

    def face(self, client: viser.ClientHandle) -> None:
        """Turn one client's view back to the front of the picture."""
        client.camera.up_direction = (0.0, 1.0, 0.0)
        client.camera.look_at = (0.0, 0.0, 0.0)
        client.camera.position = (0.0, 0.0, self.far)

    @property
    def far(self) -> float:
        """Distance from which the whole picture is seen."""
        return 0.62 * max(self.plane.size) / float(np.tan(0.5 * FOV))

    def _place_camera(self) -> None:
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.up = (0.0, 0.0, self.far), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        camera.fov = FOV
        self.server.scene.set_up_direction("+y")
        self.server.scene.world_axes.visible = False

    def _arrows(self, name: str, color: tuple[int, int, int], *, thick: float) -> viser.ArrowsHandle:
        none = np.zeros((1, 2, 3), np.float32)
        return self.server.scene.add_arrows(
            name,
            none,
            color,
            shaft_radius=thick,
            head_radius=2.6 * thick,
            head_length=5 * thick,
            visible=False,
        )

    def _lines(
        self, name: str, points: np.ndarray, color: tuple[int, int, int], *, thick: float
    ) -> viser.LineSegmentsHandle:
        return self.server.scene.add_line_segments(
            name, points.astype(np.float32), color, thickness=thick, visible=False
        )


def ring(plane: Plane, middle: Float64[np.ndarray, "2"], radius_px: float) -> np.ndarray:
    """A circle around ``middle`` as segments of the scene."""
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS)
    circle = middle + radius_px * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return _segments(plane.to_scene(circle, lift=FRONT)).astype(np.float32)


def _segments(line: np.ndarray) -> np.ndarray:
    return np.stack([line[:-1], line[1:]], axis=1)
