"""A run whose Gaussians live in the picture: one sheet in the scene, the same for everyone who looks."""

from collections.abc import Callable

import numpy as np
import viser
from jaxtyping import Float64

from lagsplat.forces.held import Held
from lagsplat.viewer.board import Act, lines, segments
from lagsplat.viewer.easel import FlatEasel, Picture
from lagsplat.viewer.overlay import rest_outline
from lagsplat.viewer.plane import Plane
from lagsplat.viewer.pull import FlatPull

PICTURE = "/picture"
QUALITY = 90
FOV = 0.75
UPRIGHT = (0.0, 1.0, 0.0, 0.0)
"""viser hangs the rows of a picture along +y"""
FRONT = 0.02
"""What is drawn over the picture stands this far before it."""
REST = (64, 196, 255)


class Sheet:
    """A `lagsplat.viewer.board.Board` with a picture in it, which is turned and dragged as a whole."""

    face_label = "Face the picture"
    axes = np.eye(2)

    def __init__(self, server: viser.ViserServer, held: Held, easel: FlatEasel) -> None:
        self.server, self.easel = server, easel
        self.plane = Plane(held.kinematics.width, held.kinematics.height)
        self.size = self.plane.size
        self._place_camera()
        blank, (width, height) = easel.draw(held.rest.numpy()), self.size
        self.picture = server.scene.add_image(
            PICTURE, blank, width, height, format="jpeg", jpeg_quality=QUALITY,
            cast_shadow=False, receive_shadow=False, wxyz=UPRIGHT,
        )  # fmt: skip
        outline = [segments(self.over(line)) for line in rest_outline(held)]
        points = np.concatenate(outline or [np.zeros((1, 2, 3))])
        self.rest = lines(server.scene, "/rest", points, REST, thick=0.014)

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
                press = FlatPull(self.plane.to_pixels(event.start_position, eye=eye))
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
