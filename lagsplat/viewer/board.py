"""What shows the filmed object to visitors and tells what they do to it: a sheet, or windows into space."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
import viser
from jaxtyping import Float64

from lagsplat.viewer.pull import Pointer, Pull

Act = Callable[[str, Pull | None, Pointer, int], None]
"""Is told the phase of a drag (start, update, end), what was pressed, where the pointer is, and whose it is;
None for what makes no sense."""


@runtime_checkable
class Board(Protocol):
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


def lines(
    scene: viser.SceneApi, name: str, points: np.ndarray, color: tuple[int, int, int], *, thick: float
) -> viser.LineSegmentsHandle:
    """Hidden line segments (N, 2, 3) of a scene, as thick as told in its unit."""
    return scene.add_line_segments(name, points.astype(np.float32), color, thickness=thick, visible=False)


def segments(line: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "m 2 k"]:
    """A line through corners as segments."""
    return np.stack([line[:-1], line[1:]], axis=1)
