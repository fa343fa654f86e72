"""The trajectory of a LeRobot dataset: states as coordinates, actions as inputs, episodes as clips."""

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from lagsplat.io.files.atomic import StrPath
from lagsplat.io.lerobot.dataset import Feature, LerobotDataset, open_dataset
from lagsplat.io.lerobot.samples import EpisodeSamples, read_samples
from lagsplat.io.lerobot.units import (
    ACTION,
    STATE,
    convert,
    decide_unit,
    describe_unit,
    is_joint,
    require_unit,
)
from lagsplat.io.trajectory.columns import SEGMENT, TIME, Table, name_columns
from lagsplat.io.trajectory.trajectory import Trajectory, make_trajectory

TARGET = "_target"
"""Ends the name of an action that has the name of a state: the goal of that coordinate."""


def read_lerobot_trajectory(
    path: StrPath, *, columns: Mapping[str, str] | None = None, joint_unit: str | None = None
) -> Trajectory:
    """Read every episode of the dataset in the folder ``path``.

    Without ``columns``, the joints of ``observation.state`` are the coordinates and ``action`` the inputs,
    both under their own names; an action with the name of a state gets the ending ``_target``. With
    ``columns``, only what it names is read, under standard names: ``{"q0": "elbow_flex.pos", "u0":
    "elbow_flex.pos"}``, the first of ``observation.state`` and the second of ``action``, or any number by its
    whole name. Units follow `lagsplat.io.lerobot.units`; a warning says what was done. Episodes lie 1 s
    apart.

    Raises:
        FileNotFoundError: a file of the dataset is missing.
        ValueError: as `open_dataset` and `read_samples`; no unit can be told; or a column does not exist.
    """
    dataset = open_dataset(path)
    given = _complete_names(dataset, columns or {})
    chosen = given or _propose_columns(dataset)
    features = _find_features(dataset, chosen.values())
    samples = read_samples(dataset, features, dataset.episodes)
    states = {name: values for name, values in samples.columns.items() if name.startswith(STATE)}
    unit = decide_unit(dataset, {n: v for n, v in states.items() if is_joint(n)}, setting=joint_unit)
    used = {name: samples.columns[name] for name in chosen.values() if name not in (TIME, SEGMENT)}
    if any(is_joint(name) for name in used):
        require_unit(dataset, unit)
        warnings.warn(f"{dataset.path.name}: {describe_unit(unit, used)}", stacklevel=3)
    table = _make_table(dataset, samples, convert(used, unit))
    motion = make_trajectory(name_columns(table, chosen), source=dataset.path.name)
    return motion if given else _name_by_features(motion, chosen)


def _propose_columns(dataset: LerobotDataset) -> dict[str, str]:
    """Standard names of the joints' states, of their rates if each has one, and of the actions."""
    state = dataset.features.get(STATE)
    if state is None or not state.parts:
        known = ", ".join(feature.name for feature in dataset.numeric) or "none"
        raise ValueError(
            f"{dataset.path}: no feature {STATE!r} of numbers; there are {known}. Name the coordinates, as "
            "diagnose.columns={q0: FEATURE.NAME, u0: FEATURE.NAME}"
        )
    joints = [name for name in state.columns if is_joint(name)]
    rates = [f"{name.removesuffix('.pos')}.vel" for name in joints]
    action = dataset.features.get(ACTION)
    proposed = {f"q{i}": name for i, name in enumerate(joints)}
    if set(rates) <= set(state.columns):
        proposed |= {f"v{i}": name for i, name in enumerate(rates)}
    return proposed | {f"u{i}": name for i, name in enumerate(action.columns if action else ())}


def _complete_names(dataset: LerobotDataset, columns: Mapping[str, str]) -> dict[str, str]:
    """The mapping with whole names: of a state for coordinates and rates, of an action for inputs."""
    whole = {column for feature in dataset.numeric for column in feature.columns}
    return {
        name: own if own in whole else f"{ACTION if name.startswith('u') else STATE}.{own}"
        for name, own in columns.items()
        if name not in (TIME, SEGMENT)  # the dataset's own, whatever a table beside it calls them
    }


def _find_features(dataset: LerobotDataset, columns: Iterable[str]) -> list[Feature]:
    """The features that hold these columns, and the states, by which units are told."""
    wanted = set(columns)
    known = [column for feature in dataset.numeric for column in feature.columns]
    lacking = sorted(wanted - set(known))
    if lacking:
        raise ValueError(
            f"{dataset.path}: no number {lacking[0]!r} for diagnose.columns; there are {', '.join(known)}"
        )
    return [
        feature
        for feature in dataset.numeric
        if feature.name == STATE or wanted.intersection(feature.columns)
    ]


def _make_table(dataset: LerobotDataset, samples: EpisodeSamples, used: Mapping[str, np.ndarray]) -> Table:
    numbers = np.concatenate(
        [np.full(stop - start, i) for i, (start, stop) in enumerate(samples.clips)], dtype=float
    )
    columns = {TIME: samples.time_s, SEGMENT: numbers, **used}
    return Table(dataset.path.name, columns, np.arange(len(numbers)), row="frame")


def _name_by_features(motion: Trajectory, chosen: Mapping[str, str]) -> Trajectory:
    q_names = tuple(chosen[name].removeprefix(f"{STATE}.") for name in motion.q_names)
    u_names = [chosen[name].removeprefix(f"{ACTION}.") for name in motion.u_names]
    targets = tuple(f"{name}{TARGET}" if name in q_names else name for name in u_names)
    return replace(motion, q_names=q_names, u_names=targets)
