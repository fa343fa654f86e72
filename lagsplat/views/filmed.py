"""Novel views from the films of a rig."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lagsplat.io.clips import find_clips
from lagsplat.io.decode import picture_size
from lagsplat.io.recording import Recording
from lagsplat.views.camera import Camera
from lagsplat.views.novel import NovelViews
from lagsplat.views.rig import Rig, RigCamera


def filmed_views(rig: Rig, recording: Recording, film: Path, read: Callable[[Path], Recording]) -> NovelViews:
    """The rig's films beside ``recording``, which was read from the reference camera's ``film``.

    ``read`` reads another film as the recording was read, in its size.

    Raises:
        ValueError: a film has another size than its camera says, other instants or another number of them.
    """
    _require_size("the reference", rig.space.reference, film)
    pictures = []
    for each in rig.others:
        assert each.video is not None, "the rig names a video for every other camera"
        _require_size(f"camera {each.name!r}", each.camera, each.video)
        other = read(each.video)
        _require_instants(each, other, recording)
        pictures.append(np.asarray(other.frames))
    height, width = recording.height, recording.width
    return NovelViews(
        images=np.stack(pictures, axis=1),
        cover=None,
        cameras=tuple(each.camera.resized(height, width) for each in rig.others),
        names=tuple(each.name for each in rig.others),
        held_out=np.array([each.held_out for each in rig.others]),
        space=rig.space.resized(height, width),
    )


def _require_size(who: str, camera: Camera, film: Path) -> None:
    height, width = picture_size(find_clips(film)[0], dt_s=None)
    if (height, width) != (camera.height, camera.width):
        raise ValueError(
            f"{who} was calibrated on pictures of {camera.width} x {camera.height} pixels and {film} has "
            f"{width} x {height}: give the film it was calibrated for, or calibrate again"
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
