"""Canvases show the object in the browser and receive drags on it.

An `ImageCanvas` is one image in the scene, the same for every visitor. A `CameraCanvas` is for a run in
space: each visitor sees a background image drawn for their own camera, and invisible drag proxies in the
scene let the browser distinguish a drag of the object from one that turns the view.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
import viser
from jaxtyping import Float64

from lagsplat.array_types import Vector
from lagsplat.forces.grasp import Place, Point
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.forces.ray import cast_ray, find_matter_depth
from lagsplat.splat.projection import make_view
from lagsplat.viewer.rendering import overlays
from lagsplat.viewer.rendering.renderer import ImageRenderer, RgbImage, SceneRenderer
from lagsplat.viewer.rendering.scene_frame import FLIP, ImagePlane, SceneFrame
from lagsplat.views.camera import Camera
from lagsplat.views.novel import cameras_bytes

BEYOND = 0.5  # how far outside a window a pointer still counts, as a share of its size
QUALITY = 90  # JPEG quality of the images [percent]
FOV = 0.75  # vertical field of view of a visitor whose window is not known yet [rad]
LEAST_FOV = 1e-4  # changes that are smaller are not made [rad]
FILLED = 1.12  # size of the window over the image that fills it, one way
UPRIGHT = (0.0, 1.0, 0.0, 0.0)  # turns an image upright: viser puts its rows along +y
FRONT = 0.02  # distance between an overlay and the image below it
Pointer = Float64[np.ndarray, "2"]


class ImageDrag:
    """A drag in the image [px of the training resolution] that began at the pixel ``press``."""

    def __init__(self, press: Pointer) -> None:
        self.press = press

    def find_target(self, q: Vector) -> Point:
        """The pressed pixel."""
        return float(self.press[0]), float(self.press[1])

    def displacement(self, pointer: Pointer) -> Float64[np.ndarray, "2"]:
        """The vector from the press to the pixel ``pointer``."""
        return pointer - self.press


class RayDrag:
    """A drag in the image of a ``camera`` in space that began at the pixel ``press``.

    The ray through the pressed pixel meets a Gaussian. The drag lies in the plane through that point parallel
    to the image, so that the pulled point follows the pointer on the screen.

    Source: paper, "Forces in three dimensions".
    """

    def __init__(self, operating_point: OperatingPoint, camera: Camera, press: Pointer) -> None:
        self.operating_point, self.camera, self.press = operating_point, camera, press
        self.depth = 0.0

    def find_target(self, q: Vector) -> Place:
        """The point of the ray on the matter that it meets, or on the first Gaussian.

        Raises:
            NoMatterError: it meets nothing.
        """
        autoencoder, chart = self.operating_point.autoencoder, self.operating_point.chart
        pixel, size = (float(self.press[0]), float(self.press[1])), (self.camera.height, self.camera.width)
        state, view = torch.from_numpy(q), make_view([self.camera])
        hit = cast_ray(autoencoder, chart, state, view, pixel, size=size)
        self.depth = find_matter_depth(self.operating_point.matter, state, view, pixel, hit)
        x, y, z = (self.camera.position + self.depth * self.camera.ray(pixel)).tolist()
        return x, y, z

    def displacement(self, pointer: Pointer) -> Float64[np.ndarray, "3"]:
        """The vector from the press to the pointer in the plane of the drag; zero before `find_target`."""
        right, down = self.depth * (pointer - self.press) / np.array(self.camera.focal)
        return right * self.camera.rotation[0] + down * self.camera.rotation[1]


Drag = ImageDrag | RayDrag
DragHandler = Callable[[str, Drag | None, Pointer, int], None]
"""Called with the phase of a drag (start, update, end), the drag or None where it is invalid, the pointer and
the number of the client."""


def listen_to_drags(
    node: viser.ImageHandle | viser.BatchedMeshHandle,
    locate: Callable[[viser.SceneNodeDragEvent], tuple[Drag, Pointer]],
    act: DragHandler,
) -> None:
    """Call ``act`` with every drag of a node; ``locate`` finds where it began and where it is.

    viser delivers about 20 updates a second of a drag on a node, and an end when its tab is closed.
    """

    @node.on_drag("left")
    async def _(event: viser.SceneNodeDragEvent) -> None:  # async: phases arrive in their order
        drag: Drag | None
        try:
            drag, pointer = locate(event)
        except ValueError:
            drag, pointer = None, np.full(2, np.nan)
        act(event.phase, drag, pointer, event.client_id)


def listen_to_cameras(
    server: viser.ViserServer, choose_fov: Callable[[float], float], act: Callable[[], None]
) -> None:
    """Set the field of view of every visitor by the shape of their window; call ``act`` at each change."""

    @server.on_client_connect
    async def _(client: viser.ClientHandle) -> None:
        @client.camera.on_update
        async def _(camera: viser.CameraHandle) -> None:
            width, height = camera.image_width, camera.image_height
            if width > 0 and height > 0:
                fov = choose_fov(width / height)
                if abs(camera.fov - fov) > LEAST_FOV:
                    camera.fov = fov
            act()


def add_image(
    scene: viser.SceneApi, name: str, image: RgbImage, size: tuple[float, float], *, left: float = 0.0
) -> viser.ImageHandle:
    """Add an upright image to a scene, ``left`` units beside its origin."""
    node = scene.add_image(name, image, *size, format="jpeg", jpeg_quality=QUALITY, wxyz=UPRIGHT)
    node.cast_shadow = node.receive_shadow = False
    node.position = (left, 0.0, 0.0)
    return node


def place_first_camera(server: viser.ViserServer, eye: tuple[float, float, float], fov: float) -> None:
    """Let new visitors look at the origin of the scene from ``eye``."""
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up, camera.fov = eye, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), fov


def look_from(camera: viser.CameraHandle, eye: tuple[float, float, float]) -> None:
    """Let a visitor look at the origin of the scene from ``eye``."""
    camera.up_direction, camera.look_at = (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)
    camera.position = eye
    camera.look_at = (0.0, 0.0, 0.0)  # setting the position has moved it


class ImageCanvas:
    """Shows a run in the image plane: one image for every visitor.

    ``size`` is the width and height of the image in the scene, ``axes`` are the directions to the right and
    down in the latest drag.
    """

    reset_view_label = "Face the image"
    axes = np.eye(2)

    def __init__(
        self, server: viser.ViserServer, operating_point: OperatingPoint, renderer: ImageRenderer
    ) -> None:
        self.server, self.renderer = server, renderer
        self.image_plane = ImagePlane(operating_point.width, operating_point.height)
        self.size = self.image_plane.size
        place_first_camera(server, (0.0, 0.0, self.far), FOV)
        blank = renderer.draw(operating_point.rest.numpy())
        self.image_node = add_image(server.scene, "/picture", blank, self.size)
        lines = overlays.trace_rest_outline(operating_point)
        outline = [overlays.to_segments(self.to_scene(line)) for line in lines]
        points = np.concatenate(outline or [np.zeros((1, 2, 3))])
        self.rest = overlays.draw_lines(server.scene, "/rest", points, overlays.REST, thick=0.014)

    def paint(self, q: Vector) -> RgbImage:
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
        look_from(client.camera, (0.0, 0.0, self.far))

    def listen(self, on_drag: DragHandler, on_camera_change: Callable[[], None]) -> None:
        """Call ``on_drag`` with every drag of the image, which does not depend on the camera."""
        listen_to_drags(self.image_node, self._locate, on_drag)
        listen_to_cameras(self.server, self.choose_fov, lambda: None)

    @property
    def far(self) -> float:
        """Distance of the camera from the image."""
        return 0.62 * max(self.size) / float(np.tan(0.5 * FOV))

    def choose_fov(self, aspect: float) -> float:
        """Vertical field of view [rad] at which the image fills a window of ``aspect``."""
        half = 0.5 * FILLED * max(self.size[1], self.size[0] / aspect)
        return float(2.0 * np.arctan(half / self.far))

    def _locate(self, event: viser.SceneNodeDragEvent) -> tuple[ImageDrag, Pointer]:
        eye = tuple(event.client.camera.position)
        press = self.image_plane.to_pixels(event.start_position, eye=eye)
        return ImageDrag(press), self.image_plane.to_pixels(event.end_position, eye=eye)


class CameraView(NamedTuple):
    """The image for one visitor and the camera it was drawn from."""

    client: viser.ClientHandle
    camera: Camera
    image: RgbImage


class PaintedFrame(NamedTuple):
    """A painted state: the drag proxies in the scene, and the views that have changed."""

    places: Float64[np.ndarray, "K 3"]
    halves: Float64[np.ndarray, "K 3"]
    windows: list[CameraView]


class CameraCanvas:
    """Shows a run in space, with one image of ``side`` pixels for each visitor; else as `ImageCanvas`."""

    reset_view_label = "Look from the recording camera"

    def __init__(
        self, server: viser.ViserServer, operating_point: OperatingPoint, renderer: SceneRenderer, side: int
    ) -> None:
        self.server, self.operating_point, self.renderer, self.side = server, operating_point, renderer, side
        image_plane = ImagePlane(operating_point.width, operating_point.height)
        self.scene_frame, self.size = SceneFrame(renderer.center[2], image_plane), image_plane.size
        self.axes, self.drag_proxies = np.eye(3)[:2], overlays.DragProxies(operating_point)
        rest = operating_point.rest.numpy()
        of_matter = self.drag_proxies.of_matter
        self.silhouettes = overlays.Silhouettes(renderer, self.scene_frame, of_matter, rest)
        self.resting = False
        self.drawn_keys: dict[int, bytes] = {}
        place_first_camera(server, self.scene_frame.eye, self.scene_frame.fov(self.size[0] / self.size[1]))
        renderer.draw(rest)  # compiles the rasterizer, so that the first visitor need not wait
        corners, faces = overlays.make_ball()
        at_rest = self.paint(rest)
        self.proxy_node = server.scene.add_batched_meshes_simple(
            "/matter",
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

    def paint(self, q: Vector) -> PaintedFrame:
        """Place the drag proxies and draw the image of every visitor whose view has changed."""
        windows = []
        for client_id, client in self.server.get_clients().items():
            try:
                camera = self.camera(client)
            except ValueError:
                continue  # a visitor with an invalid camera keeps the previous image
            key = cameras_bytes([camera]) + q.tobytes()
            if self.drawn_keys.get(client_id) != key:
                self.drawn_keys[client_id] = key
                windows.append(CameraView(client, camera, self.renderer.render_view(q, camera)))
        places, halves = self.drag_proxies.ellipsoids(q)
        unit = self.scene_frame.image_plane.unit
        return PaintedFrame(self.scene_frame.to_scene(places), halves / unit, windows)

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
                self.silhouettes.update(window.client, window.camera)

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
        look_from(client.camera, self.scene_frame.eye)

    def camera(self, client: viser.ClientHandle) -> Camera:
        """A visitor's camera in the coordinates of the run.

        Raises:
            ValueError: numbers that define no camera.
        """
        look = client.camera
        try:
            wxyz, position = np.asarray(look.wxyz, np.float64), np.asarray(look.position, np.float64)
            fov, aspect = float(look.fov), float(look.image_width) / float(look.image_height)
            return self.scene_frame.camera(
                wxyz=wxyz, position=position, fov=fov, aspect=aspect, side=self.side
            )
        except (TypeError, ZeroDivisionError, OverflowError) as error:
            raise ValueError(f"a visitor's camera is invalid: {error}") from error

    def _locate(self, event: viser.SceneNodeDragEvent) -> tuple[RayDrag, Pointer]:
        camera = self.camera(event.client)
        places = (event.start_screen_pos, event.end_screen_pos)
        press, pointer = (to_pixel(camera, place) for place in places)
        if event.phase == "start":
            self.axes = camera.rotation[:2]
        return RayDrag(self.operating_point, camera, press), pointer

    def listen(self, on_drag: DragHandler, on_camera_change: Callable[[], None]) -> None:
        """Call these with every drag of the object, and when a visitor arrives or looks elsewhere."""
        listen_to_drags(self.proxy_node, self._locate, on_drag)
        listen_to_cameras(self.server, self.scene_frame.fov, on_camera_change)

        @self.server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self.drawn_keys.pop(client.client_id, None)
            self.silhouettes.forget(client.client_id)


Canvas = ImageCanvas | CameraCanvas


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
