"""Canvases show the object in the browser and receive drags on it.

An `ImageCanvas` is one image in the scene, the same for every visitor. A `CameraCanvas` is for a run in
space: each visitor sees a background image drawn for their own camera, and invisible drag proxies in the
scene let the browser distinguish a drag of the object from one that turns the view.
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
from lagsplat.viewer.rendering.renderer import ImageRenderer, RgbImage, SceneRenderer
from lagsplat.viewer.rendering.scene_frame import FLIP, ImagePlane, SceneFrame
from lagsplat.views.camera import Camera

MATTER = "/matter"
BEYOND = 0.5  # how far outside a window a pointer still counts, as a share of its size
IMAGE = "/picture"
QUALITY = 90  # JPEG quality of the images [percent]
FOV = 0.75  # vertical field of view [rad]
UPRIGHT = (0.0, 1.0, 0.0, 0.0)  # turns an image upright: viser puts its rows along +y
FRONT = 0.02  # distance between an overlay and the image below it
Pointer = Float64[np.ndarray, "2"]


@runtime_checkable
class Drag(Protocol):
    """A drag that began at the pixel ``press``."""

    press: Pointer

    def find_target(self, q: Float64[np.ndarray, " d"]) -> tuple[Point | Place, int | None]:
        """The position that was pressed at the state ``q`` [px], and in space the number of the Gaussian.

        Raises:
            ValueError: there is nothing.
        """

    def displacement(self, pointer: Pointer) -> Float64[np.ndarray, " n"]:
        """The drag to the pixel ``pointer`` [px], in the image or in space."""


DragHandler = Callable[[str, Drag | None, Pointer, int], None]
"""Called with the phase of a drag (start, update, end), the drag or None where it is invalid, the pointer and
the number of the client."""


@runtime_checkable
class Canvas(Protocol):
    """Shows a run in the scene and receives drags on it."""

    size: tuple[float, float]  # width and height of the recorded image in the scene
    axes: Float64[np.ndarray, "2 n"]
    """Directions to the right and down in the latest drag, in the coordinates of the run."""
    reset_view_label: str  # label of the button that resets the view

    def paint(self, q: Float64[np.ndarray, " d"]) -> Any:
        """Draw a state for every visitor; pass the result to `send`."""

    def send(self, painted: Any) -> None:
        """Send a painted state to the visitors."""

    def to_scene(self, places: Float64[np.ndarray, "*B n"], *, layer: int = 1) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of positions on the matter [px]; ``layer`` raises them above an image."""

    def show_rest(self, visible: bool) -> None:
        """Show or hide the outline of the object at rest."""

    def reset_view(self, client: viser.ClientHandle) -> None:
        """Turn a visitor's view to that of the recording camera."""

    def on_drag(self, act: DragHandler) -> None:
        """Call ``act`` with every drag of the object."""

    def on_camera_change(self, act: Callable[[], None]) -> None:
        """Call ``act`` when a visitor's view needs a new image."""


class ImageCanvas:
    """A `Canvas` for a run in the image plane: one image for every visitor."""

    reset_view_label = "Face the image"
    axes = np.eye(2)

    def __init__(
        self, server: viser.ViserServer, operating_point: OperatingPoint, renderer: ImageRenderer
    ) -> None:
        self.server, self.renderer = server, renderer
        self.image_plane = ImagePlane(operating_point.kinematics.width, operating_point.kinematics.height)
        self.size = self.image_plane.size
        self._place_camera()
        blank, (width, height) = renderer.draw(operating_point.rest.numpy()), self.size
        self.image_node = server.scene.add_image(
            IMAGE,
            blank,
            width,
            height,
            format="jpeg",
            jpeg_quality=QUALITY,
            cast_shadow=False,
            receive_shadow=False,
            wxyz=UPRIGHT,
        )
        outline = [to_segments(self.to_scene(line)) for line in trace_rest_outline(operating_point)]
        points = np.concatenate(outline or [np.zeros((1, 2, 3))])
        self.rest = draw_lines(server.scene, "/rest", points, REST, thick=0.014)

    def paint(self, q: Float64[np.ndarray, " d"]) -> RgbImage:
        """Draw a state."""
        return self.renderer.draw(q)

    def send(self, painted: RgbImage) -> None:
        """Send a painted state to the visitors."""
        self.image_node.image = painted

    def to_scene(self, places: Float64[np.ndarray, "*B 2"], *, layer: int = 1) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of pixels, ``layer`` steps above the image."""
        return self.image_plane.to_scene(places, lift=layer * FRONT)

    def show_rest(self, visible: bool) -> None:
        """Show or hide the outline of the object at rest."""
        self.rest.visible = visible

    def reset_view(self, client: viser.ClientHandle) -> None:
        """Turn a visitor's view back to the front of the image."""
        client.camera.up_direction = (0.0, 1.0, 0.0)
        client.camera.look_at = (0.0, 0.0, 0.0)
        client.camera.position = (0.0, 0.0, self.far)

    def on_drag(self, act: DragHandler) -> None:
        """Call ``act`` with every drag of the image.

        viser delivers about 20 updates a second of a drag on a node, and an end when its tab is closed.
        """

        @self.image_node.on_drag("left")
        async def _(event: viser.SceneNodeDragEvent) -> None:  # async: phases arrive in their order
            eye = tuple(event.client.camera.position)
            try:
                press = ImageDrag(self.image_plane.to_pixels(event.start_position, eye=eye))
                pointer = self.image_plane.to_pixels(event.end_position, eye=eye)
            except ValueError:
                act(event.phase, None, np.full(2, np.nan), event.client_id)
            else:
                act(event.phase, press, pointer, event.client_id)

    def on_camera_change(self, act: Callable[[], None]) -> None:
        """Do nothing: the image does not depend on the camera."""

    @property
    def far(self) -> float:
        """Distance from which the whole image is visible."""
        return 0.62 * max(self.size) / float(np.tan(0.5 * FOV))

    def _place_camera(self) -> None:
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.up = (0.0, 0.0, self.far), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        camera.fov = FOV


@dataclass(frozen=True)
class CameraView:
    """The image for one visitor and the camera it was drawn from; ``camera_key`` identifies the camera."""

    client: viser.ClientHandle
    camera: Camera
    camera_key: bytes
    image: RgbImage


@dataclass(frozen=True)
class PaintedFrame:
    """A painted state: the drag proxies in the scene, and the views that have changed."""

    places: Float64[np.ndarray, "K 3"]
    halves: Float64[np.ndarray, "K 3"]
    windows: list[CameraView]


class CameraCanvas:
    """A `Canvas` for a run in space, with one image of ``side`` pixels for each visitor."""

    reset_view_label = "Look from the recording camera"

    def __init__(
        self,
        server: viser.ViserServer,
        operating_point: OperatingPoint,
        renderer: SceneRenderer,
        *,
        side: int,
    ) -> None:
        self.server, self.operating_point, self.renderer, self.side = server, operating_point, renderer, side
        image_plane = ImagePlane(operating_point.kinematics.width, operating_point.kinematics.height)
        self.scene_frame, self.size = SceneFrame(renderer.center[2], image_plane), image_plane.size
        self.axes, self.drag_proxies = np.eye(3)[:2], DragProxies(operating_point)
        self.silhouettes = Silhouettes(
            renderer, self.scene_frame, self.drag_proxies.moving, operating_point.rest.numpy()
        )
        self.resting = False
        self.drawn_keys: dict[int, bytes] = {}
        self._place_camera()
        # compiles the rasterizer, so that the first visitor need not wait
        renderer.draw(operating_point.rest.numpy())
        corners, faces = make_ball()
        at_rest = self.paint(operating_point.rest.numpy())
        self.proxy_node = server.scene.add_batched_meshes_simple(
            MATTER,
            corners,
            faces,
            self.drag_proxies.orientations(FLIP),
            at_rest.places,
            batched_scales=at_rest.halves,
            opacity=0.0,
            side="double",
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def paint(self, q: Float64[np.ndarray, " d"]) -> PaintedFrame:
        """Place the drag proxies and draw the image of every visitor whose view has changed."""
        windows = []
        for client_id, client in self.server.get_clients().items():
            try:
                camera = self.camera(client)
            except ValueError:
                continue  # a visitor with an invalid camera keeps the previous image
            camera_key = b"".join(
                part.tobytes() for part in (camera.rotation, camera.position, camera.matrix())
            )
            if self.drawn_keys.get(client_id) != camera_key + q.tobytes():
                self.drawn_keys[client_id] = camera_key + q.tobytes()
                windows.append(CameraView(client, camera, camera_key, self.renderer.render_view(q, camera)))
        places, halves = self.drag_proxies.ellipsoids(q)
        return PaintedFrame(
            self.scene_frame.to_scene(places), halves / self.scene_frame.image_plane.unit, windows
        )

    def send(self, painted: PaintedFrame) -> None:
        """Send a painted state to the visitors."""
        self.proxy_node.batched_positions = painted.places.astype(np.float32)
        self.proxy_node.batched_scales = painted.halves.astype(np.float32)
        here = self.server.get_clients()
        for window in painted.windows:
            if window.client.client_id not in here:
                continue  # left while the image was drawn
            window.client.scene.set_background_image(window.image, format="jpeg", jpeg_quality=QUALITY)
            if self.resting:
                self.silhouettes.update(window.client, window.camera, window.camera_key)

    def to_scene(self, places: Float64[np.ndarray, "*B 3"], *, layer: int = 1) -> Float64[np.ndarray, "*B 3"]:
        """Scene coordinates of positions in space."""
        return self.scene_frame.to_scene(places)

    def show_rest(self, visible: bool) -> None:
        """Show or hide the outline of the object at rest, which differs for each camera."""
        if visible != self.resting:
            self.resting = visible
            self.drawn_keys.clear()
            self.silhouettes.hide()

    def reset_view(self, client: viser.ClientHandle) -> None:
        """Turn a visitor's view to that of the recording camera."""
        camera = client.camera
        camera.up_direction, camera.look_at = (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)
        camera.position = self.scene_frame.eye
        camera.look_at = (0.0, 0.0, 0.0)  # setting the position has moved it

    def fit(self, camera: viser.CameraHandle) -> None:
        """Set the field of view so that a window of any shape shows the whole recorded image."""
        if camera.image_height > 0 and camera.image_width > 0:
            camera.fov = self.scene_frame.fov(camera.image_width / camera.image_height)

    def camera(self, client: viser.ClientHandle) -> Camera:
        """A visitor's camera in the coordinates of the run.

        Raises:
            ValueError: numbers that define no camera.
        """
        viewer_camera = client.camera
        try:
            return self.scene_frame.camera(
                wxyz=np.asarray(viewer_camera.wxyz, np.float64),
                position=np.asarray(viewer_camera.position, np.float64),
                fov=float(viewer_camera.fov),
                aspect=float(viewer_camera.image_width) / float(viewer_camera.image_height),
                side=self.side,
            )
        except (TypeError, ZeroDivisionError, OverflowError) as error:
            raise ValueError(f"a visitor's camera is invalid: {error}") from error

    def on_drag(self, act: DragHandler) -> None:
        """Call ``act`` with every drag of the object.

        viser delivers about 20 updates a second of a drag on a node, and an end when its tab is closed.
        """

        @self.proxy_node.on_drag("left")
        async def _(event: viser.SceneNodeDragEvent) -> None:  # async: phases arrive in their order
            try:
                camera = self.camera(event.client)
                press = to_pixel(camera, event.start_screen_pos)
                pointer = to_pixel(camera, event.end_screen_pos)
            except ValueError:
                act(event.phase, None, np.full(2, np.nan), event.client_id)
                return
            if event.phase == "start":
                self.axes = camera.rotation[:2]
            act(event.phase, RayDrag(self.operating_point, camera, press), pointer, event.client_id)

    def on_camera_change(self, act: Callable[[], None]) -> None:
        """Call ``act`` when a visitor arrives or moves the camera."""

        @self.server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            @client.camera.on_update
            async def _(camera: viser.CameraHandle) -> None:
                self.fit(camera)
                act()

        @self.server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self.drawn_keys.pop(client.client_id, None)
            self.silhouettes.forget(client.client_id)

    def _place_camera(self) -> None:
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.up = self.scene_frame.eye, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        camera.fov = self.scene_frame.fov(self.size[0] / self.size[1])


class ImageDrag:
    """A drag in the image [px of the training resolution]."""

    def __init__(self, press: Pointer) -> None:
        self.press = press

    def find_target(self, q: Float64[np.ndarray, " d"]) -> tuple[Point, None]:
        """The pressed pixel."""
        return (float(self.press[0]), float(self.press[1])), None

    def displacement(self, pointer: Pointer) -> Float64[np.ndarray, "2"]:
        """The vector from the press to the pointer."""
        return pointer - self.press


class RayDrag:
    """A drag in the image of a ``camera`` in space.

    The ray through the pressed pixel meets a Gaussian. The drag lies in the plane through that point parallel
    to the image, so that the pulled point follows the pointer on the screen.

    Source: paper, "Forces in three dimensions".
    """

    def __init__(self, operating_point: OperatingPoint, camera: Camera, press: Pointer) -> None:
        self.operating_point, self.camera, self.press = operating_point, camera, press
        self.depth = 0.0

    def find_target(self, q: Float64[np.ndarray, " d"]) -> tuple[Place, int]:
        """The point of the ray at the depth of the first Gaussian that it meets, and its number."""
        pixel = (float(self.press[0]), float(self.press[1]))
        hit = cast_ray(
            self.operating_point.autoencoder,
            self.operating_point.chart,
            torch.from_numpy(q),
            make_view([self.camera]),
            pixel,
            size=(self.camera.height, self.camera.width),
        )
        self.depth = hit.depth
        x, y, z = (self.camera.position + hit.depth * self.camera.ray(pixel)).tolist()
        return (x, y, z), hit.gaussian

    def displacement(self, pointer: Pointer) -> Float64[np.ndarray, "3"]:
        """The vector from the press to the pointer in the plane of the drag; zero before `find_target`."""
        right, down = self.depth * (pointer - self.press) / np.array(self.camera.focal)
        return right * self.camera.rotation[0] + down * self.camera.rotation[1]


def to_pixel(camera: Camera, place: object) -> Pointer:
    """Convert a position on the screen, (0, 0) top left and (1, 1) bottom right, to a pixel of a camera.

    Raises:
        ValueError: not two finite numbers.
    """
    try:
        at = np.asarray(place, np.float64)
    except TypeError as error:
        raise ValueError(f"the pointer's position is no number: {error}") from error
    if at.shape != (2,) or not np.isfinite(at).all():
        raise ValueError(f"the pointer's position {place} is not on a screen; nothing was pushed")
    return at.clip(-BEYOND, 1.0 + BEYOND) * (camera.width, camera.height)
