"""Find the clips of a path: a video or a log, a folder of videos, or a folder of images.

Clips of a folder are sorted by name in natural order (``take2`` before ``take10``). No recording is opened,
so a plan can name every file beforehand.
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path

from lagsplat.io.robot_log.storage import is_log, list_log_files

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".wmv")
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
TIMES = "times.csv"


@dataclass(frozen=True)
class VideoClip:
    """A continuous sequence of frames: a video, or the images of a folder."""

    path: Path
    images: tuple[Path, ...] = ()  # in order; empty for a video
    times: Path | None = None  # table of the times of images, if any
    parts: tuple[Path, ...] = ()  # files of a bag whose camera it is, in order

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that determines the clip's content."""
        files = self.images or self.parts or (self.path,)
        return files if self.times is None else (*files, self.times)


def find_clips(path: str | os.PathLike[str]) -> tuple[VideoClip, ...]:
    """Find the clips at ``path``: a file or a bag is one; another folder holds videos or images.

    Hidden files and files that are neither video nor image are ignored.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: a folder with both videos and images, or with neither.
    """
    path = Path(path).expanduser()
    if path.is_file():
        return (VideoClip(path),)
    if not path.is_dir():
        raise FileNotFoundError(f"{path}: no such file or folder; check recording.path")
    if is_log(path):
        return (VideoClip(Path(path), parts=list_log_files(path)),)
    files = sorted((entry for entry in path.iterdir() if entry.is_file()), key=natural_order)
    visible = [file for file in files if not file.name.startswith(".")]
    films = [file for file in visible if file.suffix.lower() in VIDEO_SUFFIXES]
    images = [file for file in visible if file.suffix.lower() in IMAGE_SUFFIXES]
    if films and images:
        raise ValueError(
            f"{path}: holds {len(films)} films ({films[0].name}, ...) and {len(images)} images "
            f"({images[0].name}, ...); keep the films or the images of a recording in a folder of their own"
        )
    if not films and not images:
        films_or_images = f"a film ({' '.join(VIDEO_SUFFIXES)}) nor an image ({' '.join(IMAGE_SUFFIXES)})"
        raise ValueError(f"{path}: holds neither {films_or_images}; name a film or a folder of either")
    if films:
        return tuple(VideoClip(film) for film in films)
    times = path / TIMES
    return (VideoClip(path, tuple(images), times if times.is_file() else None),)


def natural_order(path: Path) -> tuple[tuple[int, str], ...]:
    """Sort key by the numbers in a name: ``img2`` before ``img10``."""
    parts = re.split(r"(\d+)", path.name)
    counted = ((int(part), "") if part.isdigit() else (-1, part.lower()) for part in parts)
    return (*counted, (-1, path.name))
