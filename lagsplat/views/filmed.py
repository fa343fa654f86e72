"""Novel views from the films of a rig."""

from collections.abc import Callable

import numpy as np

from lagsplat.io.recording import Recording
from lagsplat.views.camera import Camera
from lagsplat.views.novel import NovelViews
from lagsplat.views.rig import Rig, RigCamera

SAME_ASPECT = 0.01


def filmed_views(rig: Rig, recording: Recording, read: Callable[[str], Recording]) -> NovelViews:
    """The rig's films beside ``recording``, its reference camera's, in the recording's size.

    ``read`` reads a film as the recording was read, frames and times alike.

    Raises:
        ValueError: a film has another shape than its camera says, other instants or another number of them.
    """
    height, width = recording.height, recording.width
    _require_shape("the reference", rig.space.reference, height, width)
    pictures = []
    for each in rig.others:
        film = read(str(each.video))
        _require_shape(f"camera {each.name!r}", each.camera, film.height, film.width)
        _require_instants(each, film, recording)
        pictures.append(np.asarray(film.frames))
    return NovelViews(
        images=np.stack(pictures, axis=1),
        cover=None,
        cameras=tuple(each.camera.resized(height, width) for each in rig.others),
        names=tuple(each.name for each in rig.others),
        held_out=np.array([each.held_out for each in rig.others]),
        space=rig.space.resized(height, width),
    )


def _require_shape(who: str, camera: Camera, height: int, width: int) -> None:
    ratio = (camera.width / camera.height) / (width / height)
    if abs(ratio - 1.0) > SAME_ASPECT:
        raise ValueError(
            f"{who} was calibrated on {camera.width} x {camera.height} pixels and its film is of {width} x "
            f"{height}: another shape; do not crop or turn films of a rig, or calibrate again"
        )


def _require_instants(each: RigCamera, film: Recording, recording: Recording) -> None:
    if film.n_frames != recording.n_frames:
        raise ValueError(
            f"camera {each.name!r} filmed {film.n_frames} frames and the reference {recording.n_frames}; cut "
            "both to the same instants"
        )
    spacing = float(np.median(np.diff(recording.time_s)))
    own, reference = (times - times[0] for times in (film.time_s, recording.time_s))
    off = float(np.abs(own - reference).max())
    if off > 0.5 * spacing:
        raise ValueError(
            f"camera {each.name!r} is up to {off:.4f} s off the reference, whose frames are {spacing:.4f} s "
            "apart; a rig films synchronously"
        )
