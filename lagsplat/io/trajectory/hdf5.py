"""Read tables from HDF5: plain datasets beside a time, or demonstrations as robomimic writes them.

Only numbers inside the file are read. Links are not followed, so that no other file is ever opened.
"""

import json
import subprocess
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.io.files.optional_package import require_package
from lagsplat.io.trajectory.columns import SEGMENT, TIME, Table, propose_names
from lagsplat.io.trajectory.timing import lay_out_clocks
from lagsplat.processes import run_reader

HDF5_SUFFIXES = (".h5", ".hdf5")
DEMOS, ACTIONS, SETTINGS, RATE = "data", "actions", "env_args", "control_freq"
"""Names of robomimic: demonstrations, what was commanded, and settings with the rate of control [Hz]."""
MOST_COLUMNS = 256  # of one dataset; a wider one is a picture or a state of something else
MOST_S, PATIENCE_S = 3, 120  # of a processor, and of the clock, for a text that is read in milliseconds
READ_TEXT = """
import sys
import h5py
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[4]),) * 2)
except ImportError:
    pass
with h5py.File(sys.argv[1], "r") as file:
    text = file[sys.argv[2]].attrs[sys.argv[3]]
sys.stdout.buffer.write(text.encode(errors="replace") if isinstance(text, str) else b"")
"""
"""A program that prints the text of an attribute: file, group, attribute, seconds of a processor."""
AGAIN = "copy or write the file again"
DAMAGE = (OSError, RuntimeError, KeyError)
"""What HDF5 raises on a damaged file, by what it was asked."""


@dataclass
class _Contents:
    """Datasets of numbers by their path, groups, and why other entries are not read."""

    arrays: dict[str, Any] = field(default_factory=dict)
    groups: list[str] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Hdf5Survey:
    """What a file holds: groups, datasets with shapes, demonstrations, columns, and what is not read."""

    path: Path
    groups: tuple[str, ...]
    datasets: tuple[str, ...]
    demos: tuple[tuple[str, int], ...]  # name and samples of each
    columns: tuple[str, ...]
    refused: tuple[str, ...]
    proposal: Mapping[str, str]  # for `diagnose.columns`


def _require_h5py() -> Any:
    return require_package("h5py", what="an HDF5 file", extra="hdf5")


def read_hdf5(path: Path, columns: Mapping[str, str]) -> Table:
    """Read the table in the HDF5 file at ``path``.

    A dataset (T,) is a column of its path, one of (T, n) the columns ``path[0]`` to ``path[n-1]``; ``q``,
    ``v`` and ``u`` at the root are ``q0``, ... Rows are those of the time, which is ``t`` or what ``columns``
    names. Of demonstrations (``data/demo_0``, ...) each is a segment, and paths are those within one; without
    a time their samples are evenly spaced by the rate in the settings of the file.

    Raises:
        ValueError: h5py is not installed; the file is damaged; a named dataset is no numbers of this file; or
            demonstrations differ in their datasets, lack rows or have no time.
    """
    h5py = _require_h5py()
    try:
        with h5py.File(path, "r") as file:
            contents = _list_contents(h5py, file)
            demos = _find_demos(contents)
            _require_read(path, contents, columns, demos)
            if demos:
                return _read_demos(path, file, contents, demos, columns.get(TIME, TIME))
            return _read_plain(path, contents, columns.get(TIME, TIME))
    except DAMAGE as error:
        raise ValueError(f"{path}: damaged or not an HDF5 file ({error}); {AGAIN}") from error


def survey_hdf5(path: Path) -> Hdf5Survey:
    """List what the file at ``path`` holds; only shapes are read.

    Raises:
        ValueError: h5py is not installed, or the file is damaged.
    """
    h5py = _require_h5py()
    try:
        with h5py.File(path, "r") as file:
            contents = _list_contents(h5py, file)
            demos = _find_demos(contents)
            rows = {name: _samples_of(contents, name) for name in demos}
            prefix = f"{demos[0]}/" if demos else ""
            columns = [
                column
                for name, array in contents.arrays.items()
                if name.startswith(prefix)
                for column in _name_columns(name.removeprefix(prefix), array)
            ]
            datasets = [
                f"{name} {list(array.shape)} {array.dtype}" for name, array in contents.arrays.items()
            ]
    except DAMAGE as error:
        raise ValueError(f"{path}: damaged or not an HDF5 file ({error}); {AGAIN}") from error
    proposal = propose_names([*([TIME] if demos else []), *columns])
    return Hdf5Survey(
        path=path,
        groups=tuple(contents.groups),
        datasets=tuple(datasets),
        demos=tuple(rows.items()),
        columns=tuple(columns),
        refused=tuple(f"{name}: {why}" for name, why in contents.refused.items()),
        proposal={key: name for key, name in proposal.items() if key != name},
    )


def _list_contents(h5py: Any, file: Any) -> _Contents:
    """Everything in the file that can be reached without following a link."""
    contents, seen, waiting = _Contents(), set[Any](), [("", file)]
    while waiting:
        prefix, group = waiting.pop(0)
        for name in group:
            place, link = f"{prefix}{name}", group.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                contents.refused[place] = (
                    f"a link to another file ({link.filename}); copy its data into this one"
                )
                continue
            if isinstance(link, h5py.SoftLink):
                contents.refused[place] = f"a link to {link.path}; name that instead"
                continue
            item = group[name]
            if isinstance(item, h5py.Group):
                address = h5py.h5o.get_info(item.id).addr
                if address not in seen:  # a group may hold itself
                    seen.add(address)
                    contents.groups.append(place)
                    waiting.append((f"{place}/", item))
            elif why := _find_obstacle(item):
                contents.refused[place] = why
            else:
                contents.arrays[place] = item
    return contents


def _find_obstacle(item: Any) -> str:
    """Why an entry is no table of numbers inside this file; empty if it is one."""
    shape = getattr(item, "shape", None)
    if shape is None:
        return "no dataset"
    if item.external or item.is_virtual:
        return "its data are in another file; copy them into this one"
    if item.dtype.kind not in "fiub":
        kinds = {"O": "text, references or arrays of any length", "S": "text", "V": "records or bytes"}
        return f"{kinds.get(item.dtype.kind, item.dtype)}; write plain numbers"
    if len(shape) not in (1, 2) or (len(shape) == 2 and shape[1] > MOST_COLUMNS):
        return f"of shape {list(shape)}; a column is (T,) or (T, n) with n up to {MOST_COLUMNS}"
    return ""


def _find_demos(contents: _Contents) -> list[str]:
    """Paths of the demonstrations, in order of their numbers."""
    names = [name for name in contents.groups if name.startswith(f"{DEMOS}/demo_") and name.count("/") == 1]
    numbered = {name: name.rpartition("_")[2] for name in names}
    return sorted((name for name in names if numbered[name].isdigit()), key=lambda name: int(numbered[name]))


def _require_read(path: Path, contents: _Contents, columns: Mapping[str, str], demos: list[str]) -> None:
    """Refuse a column that is named, by ``columns`` or by its standard name, and holds no numbers."""
    prefix = f"{demos[0]}/" if demos else ""
    for name in (*columns.values(), TIME, SEGMENT, "q", "v", "u"):
        place = f"{prefix}{name.partition('[')[0]}"
        if place in contents.refused:
            raise ValueError(f"{path}, {place}: {contents.refused[place]}")


def _name_columns(name: str, array: Any) -> list[str]:
    if len(array.shape) == 1:
        return [f"{name}0" if name in ("q", "v", "u") else name]
    pattern = "{}{}" if name in ("q", "v", "u") else "{}[{}]"
    return [pattern.format(name, i) for i in range(array.shape[1])]


def _split(name: str, array: Any) -> dict[str, np.ndarray]:
    values = array[()].reshape(len(array), -1)
    return dict(zip(_name_columns(name, array), values.T, strict=True))


def _read_plain(path: Path, contents: _Contents, time: str) -> Table:
    lengths = Counter({name: len(array) for name, array in contents.arrays.items()})
    if not lengths:
        refused = "; ".join(f"{name}: {why}" for name, why in contents.refused.items()) or "nothing at all"
        raise ValueError(f"{path}: no dataset of numbers, (T,) or (T, n). It holds {refused}")
    own = time.partition("[")[0]
    rows = lengths[own] if own in lengths else Counter(lengths.values()).most_common(1)[0][0]
    others = [f"{name} ({length})" for name, length in lengths.items() if length != rows]
    if others:
        listed = ", ".join(others[:8]) + (", ..." if len(others) > 8 else "")
        warnings.warn(f"{path.name}: not of {rows} rows as the time, and not used: {listed}", stacklevel=4)
    columns: dict[str, np.ndarray] = {}
    for name, array in contents.arrays.items():
        if len(array) == rows:
            columns |= _split(name, array)
    return Table(path.name, columns, np.arange(rows), row="sample")


def _samples_of(contents: _Contents, demo: str) -> int:
    """Samples of a demonstration: those of its actions, or of its first dataset."""
    own = [name for name in contents.arrays if name.startswith(f"{demo}/")]
    first = f"{demo}/{ACTIONS}" if f"{demo}/{ACTIONS}" in own else next(iter(own), None)
    return 0 if first is None else len(contents.arrays[first])


def _read_demos(path: Path, file: Any, contents: _Contents, demos: list[str], time: str) -> Table:
    first = {
        name.removeprefix(f"{demos[0]}/"): array
        for name, array in contents.arrays.items()
        if name.startswith(f"{demos[0]}/")
    }
    blocks: dict[str, list[np.ndarray]] = {name: [] for name in first}
    counts = [_samples_of(contents, demo) for demo in demos]
    for demo, rows in zip(demos, counts, strict=True):
        for name, model in first.items():
            place = f"{demo}/{name}"
            array = contents.arrays.get(place)
            if array is None:
                why = contents.refused.get(place, "missing")
                raise ValueError(f"{path}, {place}: {why}, but {demos[0]}/{name} is there; write all alike")
            if array.shape != (rows, *model.shape[1:]):
                wanted = [rows, *model.shape[1:]]
                raise ValueError(
                    f"{path}, {place}: shape {list(array.shape)}, where {wanted} is due by {ACTIONS} of "
                    f"{demo} and by {demos[0]}; {AGAIN}"
                )
            blocks[name].append(array[()].reshape(rows, -1))
    columns: dict[str, np.ndarray] = {}
    for name, model in first.items():
        columns |= dict(zip(_name_columns(name, model), np.concatenate(blocks[name]).T, strict=True))
    stops = np.cumsum(counts)
    if time in columns:
        clocks = np.split(columns.pop(time).astype(np.float64), stops[:-1])
    else:
        step_s = 1.0 / _read_rate(path, file, demos[0])
        clocks = [step_s * np.arange(rows, dtype=np.float64) for rows in counts]
    columns[time] = lay_out_clocks(clocks)
    columns[SEGMENT] = np.repeat(np.arange(len(demos)), counts)
    return Table(path.name, columns, np.arange(stops[-1]), row="sample")


def _read_text(path: Path, group: str, name: str) -> str:
    """The text of an attribute, empty if it is none, read by another process.

    Text of any length lies in a heap of the file. Where that is damaged, HDF5 may look for its end forever,
    and no signal but the last ends such a process.

    Raises:
        OSError: the library does not come back, or finds the damage.
    """
    try:
        text = run_reader(READ_TEXT, str(path), group, name, str(MOST_S), timeout_s=PATIENCE_S)
    except subprocess.TimeoutExpired:
        raise OSError(f"the attribute {name} of {group} cannot be read in {PATIENCE_S} s") from None
    except ChildProcessError as error:
        told = error.strerror or f"no answer within {MOST_S} s"
        raise OSError(f"the attribute {name} of {group} cannot be read: {told}") from None
    return text.decode(errors="replace")


def _read_rate(path: Path, file: Any, demo: str) -> float:
    """Rate of control [Hz] in the settings of a robomimic file."""
    text = _read_text(path, DEMOS, SETTINGS) if SETTINGS in file[DEMOS].attrs else ""
    try:
        rate_hz = float(json.loads(text)["env_kwargs"][RATE])
    except (TypeError, ValueError, KeyError) as error:
        raise ValueError(
            f"{path}, {demo}: no time: no dataset t, and the attribute {SETTINGS} of {DEMOS} gives no "
            f"{RATE}. Name the time, as diagnose.columns={{t: NAME}}, or write t [s] into each demonstration"
        ) from error
    if not 0.0 < rate_hz < np.inf:
        raise ValueError(f"{path}, {DEMOS}: {RATE} {rate_hz} in {SETTINGS}; it must be above 0 [Hz]")
    warnings.warn(
        f"{path.name}: samples are {1.0 / rate_hz:.6g} s apart, by {RATE} in {SETTINGS}", stacklevel=5
    )
    return rate_hz
