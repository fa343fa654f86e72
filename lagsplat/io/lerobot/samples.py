"""The numbers of a LeRobot dataset's episodes: times, states, actions, each checked against the metadata."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float64

from lagsplat.io.lerobot.dataset import AGAIN, INFO, Episode, Feature, LerobotDataset, read_parquet
from lagsplat.io.trajectory.timing import Clips, lay_out_clocks

ROUNDING_S = 1e-4  # LeRobot's tolerance of a time stamp, which it writes in single precision


@dataclass(frozen=True)
class EpisodeSamples:
    """Rows of the chosen episodes, one after another, 1 s apart."""

    time_s: Float64[np.ndarray, " T"]
    columns: dict[str, Float64[np.ndarray, " T"]]  # by `Feature.columns`
    clips: Clips  # one for each episode


def choose_episodes(dataset: LerobotDataset, chosen: Sequence[int] | None) -> tuple[Episode, ...]:
    """The episodes of these numbers, all for None.

    Raises:
        ValueError: a number that is no episode, or none.
    """
    count = len(dataset.episodes)
    if chosen is None:
        return dataset.episodes
    wrong = [number for number in chosen if not 0 <= number < count]
    if wrong or not chosen:
        raise ValueError(f"{dataset.path}: episodes {list(chosen)}; there are episodes 0 to {count - 1}")
    return tuple(dataset.episodes[number] for number in sorted(set(chosen)))


def read_samples(
    dataset: LerobotDataset, features: Sequence[Feature], episodes: Sequence[Episode]
) -> EpisodeSamples:
    """Read these features of these episodes; a missing number is NaN.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: a file is damaged; an episode has another number of rows than its metadata say, or its
            times do not increase; or a feature has another shape than in ``meta/info.json``.
    """
    names = [feature.name for feature in features]
    files: dict[Path, pa.Table] = {}
    times: list[np.ndarray] = []
    blocks: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for episode in episodes:
        if episode.table not in files:
            files = {episode.table: read_parquet(episode.table, ["episode_index", "timestamp", *names])}
        rows = _select_rows(episode, files[episode.table])
        times.append(_read_clock(episode, rows, dataset.rate_hz))
        for feature in features:
            blocks[feature.name].append(_read_block(episode, rows, feature))
    joined = {feature.name: np.concatenate(blocks[feature.name]) for feature in features}
    columns = {
        column: joined[feature.name][:, i] for feature in features for i, column in enumerate(feature.columns)
    }
    stops = np.cumsum([len(part) for part in times]).tolist()
    return EpisodeSamples(lay_out_clocks(times), columns, tuple(pairwise([0, *stops])))


def _select_rows(episode: Episode, table: pa.Table) -> pa.Table:
    numbers = table["episode_index"].to_numpy()
    own = np.flatnonzero(numbers == episode.index)
    if len(own) != episode.length:
        raise ValueError(
            f"{episode.table}: {len(own)} rows of episode {episode.index}, but its metadata say "
            f"{episode.length}; {AGAIN}, or leave the episode out"
        )
    if len(own) == 0 or own[-1] - own[0] != len(own) - 1:
        raise ValueError(
            f"{episode.table}: the {len(own)} rows of episode {episode.index} do not stand together; {AGAIN}"
        )
    return table.slice(int(own[0]), len(own))


def _read_clock(episode: Episode, rows: pa.Table, rate_hz: float) -> np.ndarray:
    """Times [s] of an episode's rows, exact where the stamps are only rounded."""
    time_s = rows["timestamp"].to_numpy().astype(np.float64)
    backwards = np.flatnonzero(~(np.diff(time_s) > 0.0))
    if backwards.size:
        row = int(backwards[0])
        raise ValueError(
            f"{episode.table}: episode {episode.index} goes from {time_s[row]:.6g} s to "
            f"{time_s[row + 1]:.6g} s at its row {row + 1}; times must strictly increase: {AGAIN}"
        )
    even = np.arange(len(time_s)) / rate_hz
    return even if np.abs(time_s - time_s[0] - even).max() < ROUNDING_S else time_s


def _read_block(episode: Episode, rows: pa.Table, feature: Feature) -> np.ndarray:
    """Numbers (T, n) of a feature."""
    column = rows[feature.name].combine_chunks()
    width = len(feature.parts)
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks)
    kind = column.type
    if pa.types.is_fixed_size_list(kind) or pa.types.is_list(kind) or pa.types.is_large_list(kind):
        counts = column.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
        column = column.flatten()
    else:
        counts = np.ones(len(column), dtype=int)
    wrong = np.flatnonzero(counts != width)
    if wrong.size:
        raise ValueError(
            f"{episode.table}: row {wrong[0]} of episode {episode.index} has {counts[wrong[0]]} numbers in "
            f"{feature.name!r}, but {INFO} gives it the shape {list(feature.shape)} ({wrong.size} such "
            "rows); the dataset contradicts itself: write it again"
        )
    if not (
        pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or column.type == pa.bool_()
    ):
        raise ValueError(f"{episode.table}: {feature.name!r} holds {column.type}, no numbers; {AGAIN}")
    return column.cast(pa.float64()).to_numpy(zero_copy_only=False).reshape(-1, width)
