"""Time series in the NPZ files of MuJoCo's identification toolbox, `mujoco.sysid`.

`TimeSeries.save_to_disk` writes measurements or controls: ``times`` (T,), ``data`` (T, k) and, as JSON, the
type and the columns of each signal. `SystemTrajectory.save_to_disk` writes both and a state in one file, each
under a prefix. Measurements without controls are taken together with the file of controls beside them,
``NAME_control.npz`` for ``NAME.npz`` or ``NAME_measured.npz``.

Source: what `mujoco.sysid` 4.0.0 writes and loads.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lagsplat.io.files.atomic import replace_atomically

POSITION, VELOCITY, CONTROL = 2, 3, 5  # types of a signal: qpos and qvel of a joint, ctrl of an actuator
SUFFIXES = {POSITION: "_qpos", VELOCITY: "_qvel", CONTROL: "_ctrl"}
MEASURED_END, CONTROL_END = "_measured", "_control"  # of the stems of a pair of files
PARTS = ("sensordata", "state", "control")  # of a trajectory, the first being the one whose times count


@dataclass(frozen=True)
class Signal:
    """One signal of a series: its type in the toolbox, and its values (T,) or (T, k)."""

    name: str
    type: int
    values: np.ndarray


@dataclass(frozen=True)
class Series:
    """Signals at times (T,) [s]."""

    time_s: np.ndarray
    signals: tuple[Signal, ...]

    def name_columns(self) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Columns, ``t`` and the signals by their names, and which of them are q0, ..., v0, ..., u0, ...

        Positions and controls of one number each are the coordinates and the inputs, in the order of their
        columns; rates are those of the joints of the coordinates, if all of them are there.
        """
        columns = {"t": self.time_s}
        of_type: dict[int, list[str]] = {POSITION: [], VELOCITY: [], CONTROL: []}
        for signal in self.signals:
            values = signal.values.reshape(len(self.time_s), -1)
            single = values.shape[1] == 1
            for i, column in enumerate(values.T):
                columns[signal.name if single else f"{signal.name}[{i}]"] = column
            if single and signal.type in of_type:
                of_type[signal.type].append(signal.name)
        rates = [name.removesuffix(SUFFIXES[POSITION]) + SUFFIXES[VELOCITY] for name in of_type[POSITION]]
        complete = set(rates) <= set(of_type[VELOCITY])
        blocks = {"q": of_type[POSITION], "v": rates if complete else [], "u": of_type[CONTROL]}
        named = {f"{letter}{i}": name for letter, names in blocks.items() for i, name in enumerate(names)}
        return columns, named


def read_series(
    path: Path, arrays: Mapping[str, np.ndarray], load: Callable[[Path], Mapping[str, np.ndarray]]
) -> Series | None:
    """The series in the arrays of the file at ``path``; None if they are something else.

    Controls are interpolated linearly to the times of the measurements, and missing (NaN) outside their own.
    ``load`` gives the arrays of the file of controls beside it.

    Raises:
        ValueError: times, data or mapping do not fit one another.
    """
    if {"times", "data"} <= set(arrays):
        series = _read_part(path, arrays, "")
        beside = find_control_file(path)
        if beside is None or any(signal.type == CONTROL for signal in series.signals):
            return series
        return _join(series, _read_part(beside, load(beside), ""))
    found = [part for part in PARTS if f"{part}_times" in arrays]
    if "sensordata" not in found:
        return None
    series, *others = (_read_part(path, arrays, f"{part}_") for part in found)
    for other in others:
        series = _join(series, other)
    return series


def find_control_file(path: Path) -> Path | None:
    """The file of controls beside one of measurements, if there is one."""
    stem = path.stem.removesuffix(MEASURED_END)
    beside = path.with_name(f"{stem}{CONTROL_END}{path.suffix}")
    return beside if path.suffix.lower() == ".npz" and beside != path and beside.is_file() else None


def _read_part(path: Path, arrays: Mapping[str, np.ndarray], prefix: str) -> Series:
    times, data = arrays[f"{prefix}times"], arrays.get(f"{prefix}data", np.zeros(0))
    if times.ndim != 1 or data.ndim != 2 or len(data) != len(times):
        shapes = f"{prefix}times of shape {times.shape} and {prefix}data of shape {data.shape}"
        raise ValueError(f"{path}: {shapes}; a series of mujoco.sysid has (T,) and (T, k): save it again")
    if f"{prefix}signal_mapping" not in arrays:
        name = prefix.rstrip("_") or "data"
        return Series(times, tuple(Signal(f"{name}[{i}]", -1, x) for i, x in enumerate(data.T)))
    try:
        mapping = json.loads(str(arrays[f"{prefix}signal_mapping"]))
        places = [(name, int(kind), [int(i) for i in index]) for name, (kind, index) in mapping.items()]
        signals = [Signal(name, kind, data[:, index]) for name, kind, index in places]
    except (ValueError, TypeError, AttributeError, IndexError) as error:
        raise ValueError(
            f"{path}: {prefix}signal_mapping does not name columns of {prefix}data ({error}); save it again "
            "by TimeSeries.save_to_disk"
        ) from error
    first = {name: min(index, default=0) for name, _, index in places}
    return Series(times, tuple(sorted(signals, key=lambda signal: first[signal.name])))


def _join(leading: Series, other: Series) -> Series:
    """The signals of both at the times of the first."""
    taken = {signal.name for signal in leading.signals}
    joined = list(leading.signals)
    for signal in other.signals:
        if signal.name in taken:
            continue
        columns = signal.values.reshape(len(other.time_s), -1).T
        moved = [np.interp(leading.time_s, other.time_s, x, left=np.nan, right=np.nan) for x in columns]
        joined.append(Signal(signal.name, signal.type, np.stack(moved, axis=1)))
    return Series(leading.time_s, tuple(joined))


def write_series(path: Path, time_s: np.ndarray, signals: Sequence[Signal]) -> None:
    """Write signals of one number each, which `TimeSeries.load_from_disk` loads.

    Raises:
        OSError: ``path`` cannot be written.
    """
    mapping = {signal.name: [signal.type, [i]] for i, signal in enumerate(signals)}
    data = np.stack([signal.values for signal in signals], axis=1) if signals else np.zeros((len(time_s), 0))
    with replace_atomically(path) as temporary, temporary.open("wb") as file:
        np.savez(file, times=time_s, data=data, signal_mapping=np.asarray(json.dumps(mapping)))
