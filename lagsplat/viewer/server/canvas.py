"""A run whose Gaussians live in space: every visitor looks from a side of their own.

Behind each visitor's scene hangs the picture that the fitted model gives of their camera, drawn here. What
can be dragged stands in the scene itself, unseen: a browser tells a press on the matter, which pushes, from
one beside it, which turns the view.

What shows the filmed object to visitors and tells what they do to it: a sheet, or windows into space.

A run whose Gaussians live in the picture: one sheet in the scene, the same for everyone who looks.

What a pointer means that is pressed and moved: a place on the matter, and a way to pull it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
import viser
from jaxtyping import Float64

from lagsplat.forces.equilibrium import OperatingPoint
from lagsplat.forces.grasp import Place, Point, cast_ray
from lagsplat.splat.projection import make_view
from lagsplat.viewer.rendering.overlays import (
    REST,
    DragProxies,
    Silhouettes,
    draw_lines,
    make_ball,
    to_segments,
    trace_rest_outline,
)
from lagsplat.viewer.rendering.renderer import ImageRenderer, Picture, SceneRenderer
from lagsplat.viewer.rendering.scene_frame import FLIP, ImagePlane, SceneFrame
from lagsplat.views.camera import Camera

MATTER = "/matter"
BEYOND = 0.5
"""Of a window: how far outside of it a pointer still counts."""


@dataclass(frozen=True)
class CameraView:
    """What one visitor is to see, and from where; ``look`` tells one camera from another."""

    client: viser.ClientHandle
    camera: Camera
    look: bytes
    picture: Picture


@dataclass(frozen=True)
class PaintedFrame:
    """A state: where its matter is in the scene, and the windows in which something has changed."""

    places: Float64[np.ndarray, "K 3"]
    halves: Float64[np.ndarray, "K 3"]
    windows: list[CameraView]


Pointer = Float64[np.ndarray, "2"]


@runtime_checkable
class Drag(Protocol):
    """One drag, from its ``press`` on [px]."""

    press: Pointer

    def aim(self, q: Float64[np.ndarray, " d"]) -> tuple[Point | Place, int | None]:
        """The place that was pressed at the state ``q`` [px], and in space the Gaussian that was met.

        Raises:
            ValueError: there is nothing.
        """

    def way(self, pointer: Pointer) -> Float64[np.ndarray, " n"]:
        """How far the pointer has come [px], in the picture or in space."""


Act = Callable[[str, Drag | None, Pointer, int], None]
"""Is told the phase of a drag (start, update, end), what was pressed, where the pointer is, and whose it is;
None for what makes no sense."""


class CameraCanvas:
    """A `lagsplat.viewer.server.canvas.Canvas` of pictures, one a visitor, their longer side of ``side`` pixels."""

    face_label = "Look from the film's camera"

    def __init__(
        self, server: viser.ViserServer, held: OperatingPoint, easel: SceneRenderer, *, side: int
    ) -> None:
        self.server, self.held, self.easel, self.side = server, held, easel, side
        plane = ImagePlane(held.kinematics.width, held.kinematics.height)
        self.room, self.size = SceneFrame(easel.middle[2], plane), plane.size
        self.axes, self.matter = np.eye(3)[:2], DragProxies(held)
        self.silhouettes = Silhouettes(easel, self.room, self.matter.moves, held.rest.numpy())
        self.resting = False
        self.seen: dict[int, bytes] = {}
        self._place_camera()
        easel.draw(held.rest.numpy())  # compiles, perhaps, what would keep the first visitor waiting
        corners, faces = make_ball()
        at_rest = self.paint(held.rest.numpy())
        self.handle = server.scene.add_batched_meshes_simple(
            MATTER, corners, faces, self.matter.turned(FLIP), at_rest.places, batched_scales=at_rest.halves,
            opacity=0.0, side="double", lod="off", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def paint(self, q: Float64[np.ndarray, " d"]) -> PaintedFrame:
        """The matter, and the pictures of visitors for whom something has changed."""
        windows = []
        for who, client in self.server.get_clients().items():
            try:
                camera = self.camera(client)
            except ValueError:
                continue  # who looks from nowhere keeps the picture from before
            look = b"".join(part.tobytes() for part in (camera.rotation, camera.position, camera.matrix()))
            if self.seen.get(who) != look + q.tobytes():
                self.seen[who] = look + q.tobytes()
                windows.append(CameraView(client, camera, look, self.easel.seen(q, camera)))
        places, halves = self.matter.at(q)
        return PaintedFrame(self.room.to_scene(places), halves / self.room.plane.unit, windows)

    def put(self, painted: PaintedFrame) -> None:
        """Send it."""
        self.handle.batched_positions = painted.places.astype(np.float32)
        self.handle.batched_scales = painted.halves.astype(np.float32)
        here = self.server.get_clients()
        for window in painted.windows:
            if window.client.client_id not in here:
                continue  # left while the picture was drawn
            window.client.scene.set_background_image(window.picture, format="jpeg", jpeg_quality=QUALITY)
            if self.resting:
                self.silhouettes.put(window.client, window.camera, window.look)

    def over(self, places: Float64[np.ndarray, "*B 3"], *, layer: int = 1) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of places in space, where everything stands at its own depth."""
        return self.room.to_scene(places)

    def show_rest(self, shown: bool) -> None:
        """Show or hide the outline of the object at rest, which is another one from every side."""
        if shown != self.resting:
            self.resting = shown
            self.seen.clear()
            self.silhouettes.hide()

    def face(self, client: viser.ClientHandle) -> None:
        """Turn one visitor's view to that of the film's camera, with the whole picture in it."""
        camera = client.camera
        camera.up_direction, camera.look_at = (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)
        camera.position = self.room.eye
        camera.look_at = (0.0, 0.0, 0.0)  # position has carried it along

    def fit(self, camera: viser.CameraHandle) -> None:
        """Have the whole of the film's picture in a window, whatever its shape."""
        if camera.image_height > 0 and camera.image_width > 0:
            camera.fov = self.room.fov(camera.image_width / camera.image_height)

    def camera(self, client: viser.ClientHandle) -> Camera:
        """A visitor's camera in the run's coordinates.

        Raises:
            ValueError: numbers that are no camera's.
        """
        own = client.camera
        try:
            return self.room.camera(
                wxyz=np.asarray(own.wxyz, np.float64), position=np.asarray(own.position, np.float64),
                fov=float(own.fov), aspect=float(own.image_width) / float(own.image_height), side=self.side,
            )  # fmt: skip
        except (TypeError, ZeroDivisionError, OverflowError) as error:
            raise ValueError(f"a visitor's camera is none: {error}") from error

    def on_drag(self, act: Act) -> None:
        """Call ``act`` with every drag of the matter.

        viser delivers about 20 updates a second of a drag on a node, and an end when its tab is closed.
        """

        @self.handle.on_drag("left")
        async def _(event: viser.SceneNodeDragEvent) -> None:  # async: phases arrive in their order
            try:
                camera = self.camera(event.client)
                press, pointer = (
                    to_pixel(camera, place) for place in (event.start_screen_pos, event.end_screen_pos)
                )
            except ValueError:
                act(event.phase, None, np.full(2, np.nan), event.client_id)
                return
            if event.phase == "start":
                self.axes = camera.rotation[:2]
            act(event.phase, RayDrag(self.held, camera, press), pointer, event.client_id)

    def on_look(self, act: Callable[[], None]) -> None:
        """Call ``act`` when a visitor comes, or looks from elsewhere."""

        @self.server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            @client.camera.on_update
            async def _(camera: viser.CameraHandle) -> None:
                self.fit(camera)
                act()

        @self.server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self.seen.pop(client.client_id, None)
            self.silhouettes.forget(client.client_id)

    def _place_camera(self) -> None:
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.up = self.room.eye, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        camera.fov = self.room.fov(self.size[0] / self.size[1])


def to_pixel(camera: Camera, place: object) -> Pointer:
    """The pixel of a camera at a place on the screen, (0, 0) top left and (1, 1) bottom right.

    Raises:
        ValueError: not two finite numbers.
    """
    try:
        at = np.asarray(place, np.float64)
    except TypeError as error:
        raise ValueError(f"the pointer's place is no number: {error}") from error
    if at.shape != (2,) or not np.isfinite(at).all():
        raise ValueError(f"the pointer's place {place} is not on a screen; nothing was pushed")
    return at.clip(-BEYOND, 1.0 + BEYOND) * (camera.width, camera.height)


@runtime_checkable
class Canvas(Protocol):
    """Where a run is drawn in the scene, and touched."""

    size: tuple[float, float]
    """Of the film's picture, in the scene."""
    axes: Float64[np.ndarray, "2 n"]
    """Directions of the run's coordinates in which the latest drag was made, to the right and down."""
    face_label: str
    """What the button is called that turns the view back."""

    def paint(self, q: Float64[np.ndarray, " d"]) -> Any:
        """Draw a state for everyone who looks; to be handed to `put`."""

    def put(self, painted: Any) -> None:
        """Send what was painted."""

    def over(self, places: Float64[np.ndarray, "*B n"], *, layer: int = 1) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of places on the matter [px], before the picture where there is one."""

    def show_rest(self, shown: bool) -> None:
        """Show or hide the outline of the object at rest."""

    def face(self, client: viser.ClientHandle) -> None:
        """Turn one visitor's view to where the film was taken from."""

    def on_drag(self, act: Act) -> None:
        """Call ``act`` with whatever is dragged."""

    def on_look(self, act: Callable[[], None]) -> None:
        """Call ``act`` when what was painted no longer suits where a visitor looks from."""


PICTURE = "/picture"
QUALITY = 90
FOV = 0.75
UPRIGHT = (0.0, 1.0, 0.0, 0.0)
"""viser hangs the rows of a picture along +y"""
FRONT = 0.02
"""What is drawn over the picture stands this far before it."""


class ImageCanvas:
    """A `lagsplat.viewer.server.canvas.Canvas` with a picture in it, which is turned and dragged as a whole."""

    face_label = "Face the picture"
    axes = np.eye(2)

    def __init__(self, server: viser.ViserServer, held: OperatingPoint, easel: ImageRenderer) -> None:
        self.server, self.easel = server, easel
        self.plane = ImagePlane(held.kinematics.width, held.kinematics.height)
        self.size = self.plane.size
        self._place_camera()
        blank, (width, height) = easel.draw(held.rest.numpy()), self.size
        self.picture = server.scene.add_image(
            PICTURE, blank, width, height, format="jpeg", jpeg_quality=QUALITY,
            cast_shadow=False, receive_shadow=False, wxyz=UPRIGHT,
        )  # fmt: skip
        outline = [to_segments(self.over(line)) for line in trace_rest_outline(held)]
        points = np.concatenate(outline or [np.zeros((1, 2, 3))])
        self.rest = draw_lines(server.scene, "/rest", points, REST, thick=0.014)

    def paint(self, q: Float64[np.ndarray, " d"]) -> Picture:
        """The picture."""
        return self.easel.draw(q)

    def put(self, painted: Picture) -> None:
        """Send it."""
        self.picture.image = painted

    def over(self, places: Float64[np.ndarray, "*B 2"], *, layer: int = 1) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of places in the picture, before it."""
        return self.plane.to_scene(places, lift=layer * FRONT)

    def show_rest(self, shown: bool) -> None:
        """Show or hide the outline of the object at rest."""
        self.rest.visible = shown

    def face(self, client: viser.ClientHandle) -> None:
        """Turn one visitor's view back to the front of the picture."""
        client.camera.up_direction = (0.0, 1.0, 0.0)
        client.camera.look_at = (0.0, 0.0, 0.0)
        client.camera.position = (0.0, 0.0, self.far)

    def on_drag(self, act: Act) -> None:
        """Call ``act`` with every drag of the picture.

        viser delivers about 20 updates a second of a drag on a node, and an end when its tab is closed.
        """

        @self.picture.on_drag("left")
        async def _(event: viser.SceneNodeDragEvent) -> None:  # async: phases arrive in their order
            eye = tuple(event.client.camera.position)
            try:
                press = ImageDrag(self.plane.to_pixels(event.start_position, eye=eye))
                pointer = self.plane.to_pixels(event.end_position, eye=eye)
            except ValueError:
                act(event.phase, None, np.full(2, np.nan), event.client_id)
            else:
                act(event.phase, press, pointer, event.client_id)

    def on_look(self, act: Callable[[], None]) -> None:
        """One picture suits everyone."""

    @property
    def far(self) -> float:
        """Distance from which the whole picture is seen."""
        return 0.62 * max(self.size) / float(np.tan(0.5 * FOV))

    def _place_camera(self) -> None:
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.up = (0.0, 0.0, self.far), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        camera.fov = FOV


class ImageDrag:
    """A press in the picture [px of the training resolution]."""

    def __init__(self, press: Pointer) -> None:
        self.press = press

    def aim(self, q: Float64[np.ndarray, " d"]) -> tuple[Point, None]:
        """The press itself."""
        return (float(self.press[0]), float(self.press[1])), None

    def way(self, pointer: Pointer) -> Float64[np.ndarray, "2"]:
        """From the press to the pointer."""
        return pointer - self.press


class RayDrag:
    """A press in a pixel of a ``camera`` that looks into space.

    The ray through the pixel meets a Gaussian, and the drag lives in the plane through that point parallel to
    the image: what the pointer does on the screen, the pulled point would do under it.

    Source: paper, "Forces in three dimensions".
    """

    def __init__(self, held: OperatingPoint, camera: Camera, press: Pointer) -> None:
        self.held, self.camera, self.press = held, camera, press
        self.depth = 0.0

    def aim(self, q: Float64[np.ndarray, " d"]) -> tuple[Place, int]:
        """The point of the ray beside the Gaussian that it meets first, and its number.

        Raises:
            ValueError: as `lagsplat.forces.grasp.cast_ray`.
        """
        pixel = (float(self.press[0]), float(self.press[1]))
        hit = cast_ray(
            self.held.autoencoder, self.held.chart, torch.from_numpy(q), make_view([self.camera]), pixel,
            size=(self.camera.height, self.camera.width),
        )  # fmt: skip
        self.depth = hit.depth
        x, y, z = (self.camera.position + hit.depth * self.camera.ray(pixel)).tolist()
        return (x, y, z), hit.gaussian

    def way(self, pointer: Pointer) -> Float64[np.ndarray, "3"]:
        """From the press to the pointer, in the plane of the drag; nothing before `aim` has met something."""
        right, down = self.depth * (pointer - self.press) / np.array(self.camera.focal)
        return right * self.camera.rotation[0] + down * self.camera.rotation[1]
