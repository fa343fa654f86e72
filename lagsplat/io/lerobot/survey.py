"""Survey a LeRobot dataset without decoding its films: lengths, cameras, units, and what is damaged."""

from dataclasses import dataclass

import numpy as np

from lagsplat.io.files.atomic import StrPath
from lagsplat.io.lerobot.dataset import LerobotDataset, open_dataset
from lagsplat.io.lerobot.samples import read_samples
from lagsplat.io.lerobot.units import STATE, JointUnit, decide_unit, is_joint
from lagsplat.io.video.decode import count_missing_bytes

MOST_PROBLEMS = 5  # of one kind that are listed


@dataclass(frozen=True)
class CameraSummary:
    """One camera: the size of its pictures [pixel] as the metadata say, and its films."""

    name: str
    height: int
    width: int
    films: int
    duration_s: float


@dataclass(frozen=True)
class LerobotSurvey:
    """What a dataset holds, the unit of its joints, and what cannot be read of it."""

    dataset: LerobotDataset
    lengths: tuple[int, ...]  # frames of each episode
    cameras: tuple[CameraSummary, ...]
    unit: JointUnit
    problems: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """Duration of all episodes [s]."""
        return sum(self.lengths) / self.dataset.rate_hz


def survey_lerobot(path: StrPath) -> LerobotSurvey:
    """Survey the dataset in the folder ``path``; damaged tables and films are listed, and do not end it.

    Raises:
        FileNotFoundError, ValueError: as `open_dataset`.
    """
    dataset = open_dataset(path)
    lengths = tuple(episode.length for episode in dataset.episodes)
    states, problems = _read_states(dataset)
    unit = decide_unit(dataset, states, setting=None)
    cameras = []
    for camera in dataset.cameras:
        films = dict.fromkeys(episode.films[camera].path for episode in dataset.episodes)
        height, width = _picture_size(dataset.features[camera].shape)
        cameras.append(CameraSummary(camera, height, width, len(films), sum(lengths) / dataset.rate_hz))
        found = []
        for film in films:
            if not film.is_file():
                found.append(f"{film} is missing")
            elif lacking := count_missing_bytes(film):
                found.append(f"{film} lacks {lacking} bytes at its end")
        problems += _shorten(found)
    return LerobotSurvey(dataset, lengths, tuple(cameras), unit, tuple(problems))


def _read_states(dataset: LerobotDataset) -> tuple[dict[str, np.ndarray], list[str]]:
    """Positions of the joints in all episodes that can be read, and why others cannot."""
    found, parts = list[str](), dict[str, list[np.ndarray]]()
    try:
        read = [read_samples(dataset, dataset.numeric, dataset.episodes)]
    except (FileNotFoundError, ValueError):
        read = []
        for episode in dataset.episodes:  # one by one, to tell which of them cannot be read
            try:
                read.append(read_samples(dataset, dataset.numeric, (episode,)))
            except (FileNotFoundError, ValueError) as error:
                found.append(str(error))
    for samples in read:
        for name, values in samples.columns.items():
            if name.startswith(STATE) and is_joint(name):
                parts.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}, _shorten(found)


def _shorten(problems: list[str]) -> list[str]:
    more = len(problems) - MOST_PROBLEMS
    return [*problems[:MOST_PROBLEMS], *([f"and {more} more like these"] if more > 0 else [])]


def _picture_size(shape: tuple[int, ...]) -> tuple[int, int]:
    """Height and width of pictures with their channels first or last."""
    if len(shape) != 3:
        return 0, 0
    return (
        (shape[1], shape[2]) if shape[0] in (1, 3, 4) and shape[2] not in (1, 3, 4) else (shape[0], shape[1])
    )
