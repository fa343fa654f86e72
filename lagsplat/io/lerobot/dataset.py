"""What a LeRobot dataset holds by its own account: features, episodes, and the files of each.

Layouts are those of LeRobot 0.3.3 (version 2.1: a table and a film for each episode) and 0.4.4 (version 3.0:
several episodes a file). Only files inside the folder are opened.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lagsplat.io.files.atomic import StrPath

INFO, EPISODES, FOLDER_OF_EPISODES = "meta/info.json", "meta/episodes.jsonl", "meta/episodes"
VERSIONS = ("2.1", "3.0")
BOOKKEEPING = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Features that LeRobot adds to every dataset."""
NUMBERS = ("float16", "float32", "float64", "int8", "int16", "int32", "int64", "uint8", "bool")
AGAIN = "download or copy the dataset again"


@dataclass(frozen=True)
class Feature:
    """One feature of every frame: its kind of number, or ``video`` or ``image``, and its shape."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    parts: tuple[str, ...]  # names of its numbers, one each; empty for pictures

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its numbers among all of the dataset."""
        return tuple(f"{self.name}.{part}" if part else self.name for part in self.parts)


@dataclass(frozen=True)
class FilmSpan:
    """Where the film of an episode lies: a file, and the time of its first frame in it [s]."""

    path: Path
    start_s: float


@dataclass(frozen=True)
class Episode:
    """One episode: its number of frames, the file of its numbers and the film of each camera."""

    index: int
    length: int
    table: Path
    films: Mapping[str, FilmSpan]


@dataclass(frozen=True)
class LerobotDataset:
    """A dataset as its metadata describe it; no data have been read."""

    path: Path
    version: str
    robot: str  # empty if not said
    rate_hz: float
    features: Mapping[str, Feature]
    episodes: tuple[Episode, ...]

    @property
    def cameras(self) -> tuple[str, ...]:
        """Features that are films."""
        return tuple(name for name, feature in self.features.items() if feature.dtype == "video")

    @property
    def numeric(self) -> tuple[Feature, ...]:
        """Features of numbers, except those of the bookkeeping."""
        return tuple(feature for feature in self.features.values() if feature.parts)


def is_lerobot(path: StrPath) -> bool:
    """Whether a folder is a LeRobot dataset, or the rest of one."""
    path = Path(path)
    return (path / INFO).is_file() or (path / EPISODES).is_file() or (path / FOLDER_OF_EPISODES).is_dir()


def open_dataset(path: StrPath) -> LerobotDataset:
    """Read the metadata of the dataset in the folder ``path``.

    Raises:
        FileNotFoundError: a file of the metadata is missing.
        ValueError: a version that is not read, damaged metadata, or episodes missing or out of order.
    """
    path = Path(path)
    info = _read_info(path)
    features = {name: _read_feature(path, name, each) for name, each in info["features"].items()}
    version = str(info["codebase_version"]).removeprefix("v")
    cameras = [name for name, feature in features.items() if feature.dtype == "video"]
    read = _list_episodes if version == "2.1" else _list_packed_episodes
    episodes = read(path, info, cameras)
    announced = info.get("total_episodes", len(episodes))
    if announced != len(episodes):
        where = EPISODES if version == "2.1" else FOLDER_OF_EPISODES
        raise ValueError(
            f"{path}: {INFO} announces {announced} episodes, but {where} lists {len(episodes)}; {AGAIN}"
        )
    if not episodes:
        raise ValueError(f"{path}: a dataset without episodes; record one")
    robot = info.get("robot_type") or ""
    return LerobotDataset(path, version, str(robot), float(info["fps"]), features, tuple(episodes))


def _read_info(path: Path) -> dict[str, Any]:
    place = path / INFO
    if not place.is_file():
        raise FileNotFoundError(
            f"{place}: missing, and nothing else tells version, rate and features of the dataset; {AGAIN}"
        )
    try:
        info = json.loads(place.read_text(encoding="utf-8"))
    except ValueError as error:  # of JSON, or of UTF-8
        raise ValueError(f"{place}: damaged, no JSON ({error}); {AGAIN}") from error
    needed = ("codebase_version", "fps", "features", "data_path")
    lacking = [key for key in needed if not isinstance(info, dict) or key not in info]
    if lacking:
        raise ValueError(f"{place}: without {', '.join(lacking)}; {AGAIN}")
    version = str(info["codebase_version"])
    if version.removeprefix("v") not in VERSIONS:
        raise ValueError(
            f"{place}: codebase_version {version!r}; versions {' and '.join(VERSIONS)} are read. Convert the "
            "dataset with LeRobot's own scripts (lerobot/datasets/v21, v30)"
        )
    rate_hz = info["fps"]
    if not isinstance(rate_hz, int | float) or not 0.0 < rate_hz < math.inf:
        raise ValueError(f"{place}: fps {rate_hz!r}; it must be a rate above 0 [Hz]")
    if not isinstance(info["features"], dict):
        raise ValueError(f"{place}: features are no table of names; {AGAIN}")
    return info


def _read_feature(path: Path, name: str, given: Any) -> Feature:
    try:
        dtype, shape = str(given["dtype"]), tuple(int(side) for side in given["shape"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path / INFO}: feature {name!r} is {given!r}, without dtype and shape") from error
    parts: tuple[str, ...] = ()
    if dtype in NUMBERS and name not in BOOKKEEPING and len(shape) <= 1:
        parts = _name_parts(given.get("names"), shape[0] if shape else 1)
    return Feature(name, dtype, shape, parts)


def _name_parts(names: Any, count: int) -> tuple[str, ...]:
    """Names of the numbers of a feature: a list, a list under one key, or a table of their places."""
    if isinstance(names, dict) and len(names) == 1 and isinstance(next(iter(names.values())), list):
        (names,) = names.values()
    elif isinstance(names, dict) and all(isinstance(place, int) for place in names.values()):
        names = sorted(names, key=names.__getitem__)
    if isinstance(names, list) and len({str(name) for name in names}) == len(names) == count:
        return tuple(str(name) for name in names)
    return tuple(str(i) for i in range(count)) if count > 1 else ("",)


def _list_episodes(path: Path, info: Mapping[str, Any], cameras: list[str]) -> list[Episode]:
    """Episodes of version 2.1: one line of text, one table and one film a camera for each."""
    place = path / EPISODES
    if not place.is_file():
        raise FileNotFoundError(f"{place}: missing, so that no episode is known; {AGAIN}")
    chunks_size = int(info.get("chunks_size", 1000))
    episodes: list[Episode] = []
    for line, text in enumerate(place.read_text(encoding="utf-8").splitlines(), 1):
        if not text.strip():
            continue
        try:
            entry = json.loads(text)
            index, length = int(entry["episode_index"]), int(entry["length"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"{place}, line {line}: no episode_index and length ({error}); {AGAIN}"
            ) from error
        _require_next(f"{place}, line {line}", index, episodes)
        keys = {"episode_chunk": index // chunks_size, "episode_index": index}
        table = _locate(path, info["data_path"], keys)
        films = {
            camera: FilmSpan(_locate(path, info.get("video_path"), {**keys, "video_key": camera}), 0.0)
            for camera in cameras
        }
        episodes.append(Episode(index, length, table, films))
    return episodes


def _list_packed_episodes(path: Path, info: Mapping[str, Any], cameras: list[str]) -> list[Episode]:
    """Episodes of version 3.0: rows of tables, which tell where numbers and films lie."""
    folder = path / FOLDER_OF_EPISODES
    places = sorted(folder.glob("chunk-*/file-*.parquet"))
    if not places:
        raise FileNotFoundError(f"{folder}: no chunk-000/file-000.parquet, so no episode is known; {AGAIN}")
    spans = [
        f"videos/{camera}/{part}"
        for camera in cameras
        for part in ("chunk_index", "file_index", "from_timestamp")
    ]
    columns = ["episode_index", "length", "data/chunk_index", "data/file_index", *spans]
    episodes: list[Episode] = []
    for place in places:
        for row, entry in enumerate(read_parquet(place, columns).to_pylist()):
            empty = [name for name, value in entry.items() if value is None]
            if empty:
                raise ValueError(f"{place}, row {row}: no {empty[0]}; {AGAIN}")
            _require_next(f"{place}, row {row}", entry["episode_index"], episodes)
            table = _locate(path, info["data_path"], _part_keys(entry, "data"))
            films = {}
            for camera in cameras:
                keys = {**_part_keys(entry, f"videos/{camera}"), "video_key": camera}
                file = _locate(path, info.get("video_path"), keys)
                films[camera] = FilmSpan(file, float(entry[f"videos/{camera}/from_timestamp"]))
            episodes.append(Episode(entry["episode_index"], int(entry["length"]), table, films))
    return episodes


def _part_keys(entry: Mapping[str, Any], part: str) -> dict[str, Any]:
    return {key: int(entry[f"{part}/{key}"]) for key in ("chunk_index", "file_index")}


def _require_next(place: str, index: int, before: list[Episode]) -> None:
    if index != len(before):
        raise ValueError(
            f"{place}: episode {index} where episode {len(before)} should stand; episodes are counted from 0 "
            f"without holes. {AGAIN.capitalize()}, or write it again with LeRobot's tools"
        )


def _locate(path: Path, pattern: Any, keys: Mapping[str, Any]) -> Path:
    """A file of the dataset by its pattern, which must not lead out of the folder."""
    place = path / INFO
    try:
        name = str(pattern).format(**keys)
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        raise ValueError(f"{place}: the path {pattern!r} cannot be filled with {sorted(keys)}") from error
    if pattern is None or Path(name).is_absolute() or ".." in Path(name).parts:
        raise ValueError(f"{place}: the path {pattern!r} is none inside the dataset; {AGAIN}")
    return path / name


def read_parquet(place: Path, columns: list[str]) -> pa.Table:
    """The ``columns`` of a Parquet file.

    Raises:
        FileNotFoundError: there is no file at ``place``.
        ValueError: it is truncated or no Parquet file, or lacks a column.
    """
    if not place.is_file():
        raise FileNotFoundError(f"{place}: missing, though the metadata of the dataset name it; {AGAIN}")
    try:
        file = pq.ParquetFile(place)
        lacking = [name for name in columns if name not in file.schema_arrow.names]
        table = None if lacking else file.read(columns=columns)
    except (pa.ArrowException, OSError) as error:
        reason = re.sub(r"\s+", " ", str(error))[:200]
        raise ValueError(f"{place}: truncated or no Parquet file ({reason}); {AGAIN}") from error
    if table is None:
        has = ", ".join(file.schema_arrow.names[:20])
        raise ValueError(f"{place}: no column {lacking[0]!r}, only {has}; {AGAIN}")
    return table
