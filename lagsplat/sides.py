"""Pictures of a recording's instants from other sides, wherever they come from."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from lagsplat.io.config import RecordingConfig
from lagsplat.io.read import read_recording
from lagsplat.io.recording import Recording
from lagsplat.lifted import sharp_views
from lagsplat.shapes import Series
from lagsplat.systems.release_config import ReleaseConfig
from lagsplat.systems.sides import true_views
from lagsplat.views.config import ViewsConfig
from lagsplat.views.filmed import filmed_views
from lagsplat.views.novel import NovelViews
from lagsplat.views.rig import read_rig

Say = Callable[[str], None]


def obtain_views(
    config: ViewsConfig,
    recording: Recording,
    source: RecordingConfig,
    *,
    released: ReleaseConfig | None,
    states: Series | None,
    cache: Path,
) -> NovelViews:
    """Novel views of ``recording``, which ``source`` describes.

    ``released`` and ``states`` are the stand-in and its true states, where the recording is simulated;
    ``cache`` is the folder for lifted frames unless the settings name another.

    Raises:
        ValueError: the kind of views does not suit the recording, or as the source of the views.
        FileNotFoundError: a file of the rig is missing.
    """
    if config.kind == "simulated":
        if released is None or states is None or config.arrangement is None:
            raise ValueError(
                "views=simulated: only a mechanism that is let go and simulated has a scene in space; choose "
                "recording=simulated and such a system, or views=rig or views=none"
            )
        return true_views(released, states, config.arrangement)
    if config.sharp is not None and config.kind == "sharp":
        assert config.arrangement is not None, "checked with the settings"
        folder = cache if config.sharp.cache is None else Path(config.sharp.cache).expanduser()
        return sharp_views(recording, config.sharp, config.arrangement, folder)
    assert config.rig is not None, "checked with the settings"
    if source.kind != "video" or source.path is None:
        raise ValueError(
            f"views=rig: the recording is the reference camera's film, not of kind {source.kind}; give "
            "recording=filmed recording.path=FILM"
        )
    if source.crop or source.rotate or source.stabilise:
        raise ValueError(
            "views=rig: recording.crop, rotate and stabilise move pixels away from where the calibration has "
            "them; use whole pictures"
        )
    film = Path(source.path).expanduser()

    def read(path: Path) -> Recording:
        return read_recording(replace(source, path=str(path), height=recording.height, width=recording.width))

    return filmed_views(read_rig(Path(config.rig)), recording, film, read)
