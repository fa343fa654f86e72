"""Read a recording from a LeRobot dataset: the film of one camera, and numbers of the same frames as inputs.

LeRobot films are AV1 by default, which OpenCV's packages do not decode, so PyAV does, an extra of this
package. Row and frame belong together by their time in the episode.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from lagsplat.io.config import LerobotConfig
from lagsplat.io.files.atomic import StrPath, sha256_of
from lagsplat.io.files.optional_package import require_package
from lagsplat.io.lerobot.dataset import (
    AGAIN,
    Episode,
    Feature,
    FilmSpan,
    LerobotDataset,
    open_dataset,
)
from lagsplat.io.lerobot.samples import choose_episodes, read_samples
from lagsplat.io.lerobot.units import STATE, convert, decide_unit, describe_unit, is_joint, require_unit
from lagsplat.io.recording.recording import Recording
from lagsplat.io.video.decode import overlap_decoding
from lagsplat.provenance import sha256_hex
from lagsplat.video_quality.assessment import assess_video
from lagsplat.video_quality.frames import FrameSettings, Thumbnails, crop_and_resize, rotate_image

HALF_FRAME = 0.5  # farthest that a picture may be from the time of its row [frames]


@dataclass(frozen=True)
class _EpisodeFilm:
    """Frames of one episode, the numbers of their rows, and what was measured on its pictures."""

    frames: UInt8[np.ndarray, "T H W 3"]
    rows: np.ndarray
    footage: dict[str, Any]
    meta: dict[str, Any]


def read_lerobot(path: StrPath, chosen: LerobotConfig, settings: FrameSettings) -> Recording:
    """Read the recording in the dataset in the folder ``path``, each episode a clip.

    ``skip_s`` and ``end_s`` count from the start of each episode. Units follow `lagsplat.io.lerobot.units`; a
    warning says what was done.

    Raises:
        FileNotFoundError: a file of the dataset is missing.
        ValueError: as `open_dataset` and `read_samples`; a camera or an input does not exist, with those that
            do; no unit can be told; a film is truncated or lacks frames; no frame is
            left; or PyAV is not installed.
    """
    _require_av()
    dataset = open_dataset(path)
    camera = require_camera(dataset, chosen.camera)
    names = _choose_inputs(dataset, chosen.inputs)
    episodes = choose_episodes(dataset, chosen.episodes)
    _require_files(episodes, camera)
    features = [each for each in dataset.numeric if each.name == STATE or set(each.columns) & set(names)]
    samples = read_samples(dataset, features, episodes)
    states = {name: v for name, v in samples.columns.items() if name.startswith(STATE) and is_joint(name)}
    unit = decide_unit(dataset, states, setting=chosen.joint_unit)
    if any(is_joint(name) for name in names):
        require_unit(dataset, unit)
        warnings.warn(f"{dataset.path}: {describe_unit(unit, names)}", stacklevel=3)
    films = [
        _read_film(episode, episode.films[camera], dataset.rate_hz, samples.time_s[start:stop], settings)
        for episode, (start, stop) in zip(episodes, samples.clips, strict=True)
    ]
    rows = np.concatenate([start + film.rows for film, (start, _) in zip(films, samples.clips, strict=True)])
    columns = convert({name: samples.columns[name][rows] for name in names}, unit)
    _require_numbers(dataset, columns)
    short = [name.removeprefix("action.") for name in names]
    return Recording(
        frames=films[0].frames if len(films) == 1 else np.concatenate([film.frames for film in films]),
        time_s=samples.time_s[rows],
        inputs=np.stack(list(columns.values()), axis=1) if names else np.zeros((len(rows), 0)),
        input_names=tuple(short if len(set(short)) == len(short) else names),
        input_units=tuple(unit.unit_of(name) for name in names),
        segments=tuple(pairwise(np.cumsum([0, *(len(film.rows) for film in films)]).tolist())),
        meta=_describe(dataset, camera, chosen, settings, episodes, films),
    )


def _describe(
    dataset: LerobotDataset,
    camera: str,
    chosen: LerobotConfig,
    settings: FrameSettings,
    episodes: Sequence[Episode],
    films: Sequence[_EpisodeFilm],
) -> dict[str, Any]:
    files = dict.fromkeys(file for each in episodes for file in (each.table, each.films[camera].path))
    return {
        "origin": "filmed",
        "source": dataset.path.name,
        "sha256": sha256_hex("".join(sha256_of(file) for file in files).encode()),
        "licence": "unknown",
        "crop": None if settings.crop is None else list(settings.crop),
        "skip_s": settings.skip_s,
        "end_s": settings.end_s,
        "camera": camera,
        "episodes": [episode.index for episode in episodes],
        "joint_unit": chosen.joint_unit,
        "rotate": settings.rotate,
        "grey": settings.grey,
        "clips": [film.meta for film in films],
        "footage": [film.footage for film in films],
    }


def require_camera(dataset: LerobotDataset, camera: str | None) -> str:
    """The camera, which must be a film of the dataset.

    Raises:
        ValueError: it is none; the message lists those that are.
    """
    if camera in dataset.cameras:
        return camera
    listed = ", ".join(dataset.cameras) or "none"
    if camera and camera in dataset.features and dataset.features[camera].dtype == "image":
        problem = f"camera {camera!r} has single pictures inside the tables, and films are read"
        remedy = "convert them to films with LeRobot's tools (lerobot-edit-dataset)"
    else:
        problem = "recording.lerobot.camera is null" if camera is None else f"no camera {camera!r}"
        remedy = "set recording.lerobot.camera"
    raise ValueError(f"{dataset.path}: {problem}; cameras with films: {listed}. {remedy.capitalize()}")


def _choose_inputs(dataset: LerobotDataset, inputs: Sequence[str]) -> list[str]:
    """Columns of the inputs: all of a feature, or single ones."""
    features: dict[str, Feature] = {feature.name: feature for feature in dataset.numeric}
    known = [column for feature in dataset.numeric for column in feature.columns]
    names: list[str] = []
    for name in inputs:
        if name not in features and name not in known:
            raise ValueError(
                f"{dataset.path}: no number {name!r} for recording.lerobot.inputs; features are "
                f"{', '.join(features) or 'none'}, and their numbers {', '.join(known)}"
            )
        names += features[name].columns if name in features else (name,)
    return list(dict.fromkeys(names))


def _require_files(episodes: Sequence[Episode], camera: str) -> None:
    """Before long work: every film is there."""
    for episode in episodes:
        path = episode.films[camera].path
        if not path.is_file():
            raise FileNotFoundError(
                f"{path}: missing, the film of {camera} in episode {episode.index}; {AGAIN}, or choose other "
                "episodes "
                "with recording.lerobot.episodes"
            )


def _require_numbers(dataset: LerobotDataset, columns: dict[str, np.ndarray]) -> None:
    for name, values in columns.items():
        missing = np.flatnonzero(~np.isfinite(values))
        if missing.size:
            raise ValueError(
                f"{dataset.path}: input {name!r} is missing or not finite at frame {missing[0]} "
                f"({missing.size} such); leave it out of recording.lerobot.inputs, or choose other episodes"
            )


def _read_film(
    episode: Episode,
    span: FilmSpan,
    rate_hz: float,
    time_s: Float64[np.ndarray, " N"],
    settings: FrameSettings,
) -> _EpisodeFilm:
    since_s = time_s - time_s[0]
    wanted = since_s >= settings.skip_s
    if settings.end_s is not None:
        wanted &= since_s < settings.end_s
    thumbnails, source = Thumbnails(), str(span.path)

    def make_frame(item: tuple[int, Any]) -> tuple[int, UInt8[np.ndarray, "H W 3"]]:
        row, picture = item
        picture = rotate_image(picture.to_ndarray(format="bgr24"), settings.rotate)
        thumbnails.add(picture)
        return row, crop_and_resize(picture, settings, source=source)

    numbered = _decode(episode, span, since_s, rate_hz)
    taken = ((row, picture) for row, picture in numbered if wanted[row])
    kept = list(overlap_decoding(taken, make_frame))
    if not kept:
        cut = f"skip_s = {settings.skip_s} and end_s = {settings.end_s}"
        raise ValueError(
            f"{source}: no frame to keep of episode {episode.index}, which lasts {since_s[-1]:.3f} s, with "
            f"{cut}. Check the cut"
        )
    rows = np.array([row for row, _ in kept])
    frames = np.stack([frame for _, frame in kept])
    footage = assess_video(frames, since_s[rows], thumbnails, crop=settings.crop)
    for sentence in footage.warnings:
        warnings.warn(f"{source}: {sentence}", stacklevel=4)
    meta = {
        "source": f"episode {episode.index}",
        "frames": len(frames),
        "start_s": float(since_s[rows[0]]),
        "picture_px": [thumbnails.height, thumbnails.width],
    }
    return _EpisodeFilm(frames, rows, footage.numbers, meta)


def _decode(
    episode: Episode, span: FilmSpan, since_s: Float64[np.ndarray, " N"], rate_hz: float
) -> Iterator[tuple[int, Any]]:
    """Each row of an episode with its picture, in order.

    Raises:
        ValueError: the film cannot be opened or decoded, or a row has no picture.
    """
    av = _require_av()
    row = 0
    try:
        with av.open(str(span.path)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            if span.start_s > 0.0:
                container.seek(int((span.start_s - 1.0 / rate_hz) / stream.time_base), stream=stream)
            for picture in container.decode(stream):
                if row == len(since_s):
                    return
                late = (picture.time - span.start_s - since_s[row]) * rate_hz
                if late > HALF_FRAME:
                    break
                if late >= -HALF_FRAME:
                    yield row, picture
                    row += 1
    except (av.FFmpegError, IndexError) as error:
        raise ValueError(
            f"{span.path}: truncated, or no film that can be decoded ({error}); {AGAIN}, or leave out "
            f"episode {episode.index} with recording.lerobot.episodes"
        ) from error
    if row < len(since_s):
        raise ValueError(
            f"{span.path}: episode {episode.index} has {len(since_s)} rows, but no picture for row {row} at "
            f"{span.start_s + since_s[row]:.3f} s; the film is truncated or of another recording. "
            f"{AGAIN.capitalize()}, or leave the episode out with recording.lerobot.episodes"
        )


def _require_av() -> Any:
    return require_package("av", what="a LeRobot film", extra="lerobot")
