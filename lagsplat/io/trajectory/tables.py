"""Read tables of numbers from CSV, Parquet, NPZ and MATLAB; columns are found by name, never by guess."""

import csv
import difflib
import io
import re
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from lagsplat.io.config import CLOCKS
from lagsplat.io.trajectory.sysid_series import read_series

TIME, SEGMENT, NUMBER = "t", "segment", "(0|[1-9][0-9]*)"
STANDARD = "t [s], q0, q1, ..., optionally v0, ..., u0, ... and segment"
USUAL = {
    "t": ("t", "time", "timestamp", "stamp", "sec", "seconds", "zeit"),
    "q": ("q", "pos", "position", "angle", "theta", "phi", "x", "y", "disp", "displacement", "qpos"),
    "v": ("v", "vel", "velocity", "omega", "rate", "speed", "qvel", "dq", "dtheta"),
    "u": ("u", "tau", "torque", "force", "input", "cmd", "command", "ctrl", "pressure", "p", "voltage"),
    "segment": ("segment", "clip", "trial", "episode", "release", "run"),
}
"""Names of such columns in other tools: used to propose a setting, never to read a column."""


@dataclass(frozen=True)
class Table:
    """Columns as in the file."""

    source: str
    columns: dict[str, np.ndarray]
    lines: np.ndarray  # numbers (T,) of the rows, as an editor or an array counts them
    row: str = "row"  # what such a number counts: a line of text, a row of a table or of an array
    named: Mapping[str, str] = field(default_factory=dict)
    """The file's own columns by standard names, where its format says which they are."""

    def place(self, index: int) -> str:
        """Position of row ``index``, for messages."""
        return f"{self.source}, {self.row} {self.lines[index]}"

    def numbers(self, name: str) -> np.ndarray:
        """Column ``name`` as float64 (T,); an empty cell, NaN, null or NA is NaN.

        Raises:
            ValueError: a cell holds something else; the message names the row and the column.
        """
        column = self.columns[name]
        if column.dtype.kind in "fiub":
            return column.astype(np.float64)
        series = pd.to_numeric(pd.Series(column), errors="coerce")
        numbers = series.to_numpy(dtype=np.float64, na_value=np.nan)
        wrong = np.flatnonzero(np.isnan(numbers) & ~pd.isna(column))
        if wrong.size:
            raise ValueError(
                f"{self.place(int(wrong[0]))}: column {name!r} holds {str(column[wrong[0]])!r}, which is no "
                f"number ({wrong.size} such cells); write a decimal point, and leave a missing number empty"
            )
        return numbers

    def block(self, names: Sequence[str]) -> np.ndarray:
        """The `numbers` of these columns, (T, len(names))."""
        block = np.empty((len(self.lines), len(names)))
        for i, name in enumerate(names):
            block[:, i] = self.numbers(name)
        return block


def name_columns(table: Table, columns: Mapping[str, str], *, needed: Sequence[str] = (TIME, "q0")) -> Table:
    """Rename the columns to the standard names; ``columns`` maps these to the file's own.

    An entry that names a topic or a clock of a log is for another file where this one has the standard name.
    Where the file's format says what its columns are, that holds for letters that ``columns`` does not name.
    Columns of other names are dropped, with a warning that lists them.

    Raises:
        ValueError: an unknown name, a column that the file lacks, or a missing one of ``needed``; the
            message lists the columns found and proposes the nearest setting.
    """
    found = list(table.columns)
    known = (*found, *table.named)
    columns = {name: own for name, own in columns.items() if name not in known or not _is_of_log(own, found)}
    letters = {name[0] for name in columns}
    columns = {**{name: own for name, own in table.named.items() if name[0] not in letters}, **columns}
    for name, own in columns.items():
        if not _is_standard(name):
            raise ValueError(f"diagnose.columns names {name!r}; only {STANDARD} are known")
        if own not in found:
            near = difflib.get_close_matches(own, found, n=1, cutoff=0.0)
            problem = f"no column {own!r} for {name}, only {found}; did you mean {near[0]!r}?"
            raise ValueError(f"{table.source}: {problem}")
    taken = set(columns.values())
    named = {name: table.columns[name] for name in found if _is_standard(name) and name not in taken}
    named |= {name: table.columns[own] for name, own in columns.items()}
    missing = [name for name in needed if name not in named]
    if missing:
        problem = f"no column {' and no '.join(missing)}; the columns are {found}, and {STANDARD} are needed"
        raise ValueError(f"{table.source}: {problem}. {_proposal(found)}")
    left = [name for name in found if name not in named and name not in taken]
    if left:
        listed = f"{', '.join(left[:8])}{', ...' if len(left) > 8 else ''}"
        hint = "diagnose.columns={u0: NAME} would name one an input"
        warnings.warn(f"{table.source}: column(s) {listed} are not used; {hint}", stacklevel=3)
    return replace(table, columns=named)


def count_names(table: Table, letter: str) -> tuple[str, ...]:
    """The columns ``letter0, letter1, ...`` of a table with standard names, in that order.

    Raises:
        ValueError: a number is skipped, or only some coordinates have rates.
    """
    numbers = sorted(int(name[1:]) for name in table.columns if re.fullmatch(f"{letter}{NUMBER}", name))
    n = len(count_names(table, "q")) if letter == "v" and numbers else len(numbers)
    if numbers != list(range(n)):
        have = [f"{letter}{number}" for number in numbers]
        lack = [f"{letter}{number}" for number in range(n) if number not in numbers]
        remedy = f"{lack} are missing" if lack else f"only {n} coordinates have a rate"
        raise ValueError(f"{table.source}: columns {have}, but {remedy}; count from {letter}0 without holes")
    return tuple(f"{letter}{number}" for number in numbers)


def _is_standard(name: str) -> bool:
    return name in (TIME, SEGMENT) or re.fullmatch(f"[quv]{NUMBER}", name) is not None


def _is_of_log(own: str, found: Sequence[str]) -> bool:
    """Whether a table's ``own`` name of a column is none of those found, but that of a topic or a clock."""
    return own not in found and (own.startswith("/") or own in CLOCKS)


def _proposal(found: list[str]) -> str:
    """The most likely setting that would read this file, judged by its column names."""
    proposed: dict[str, str] = {}
    for name in found:
        kind = _kind_of(name)
        if kind in (TIME, SEGMENT):
            proposed.setdefault(kind, name)
        elif kind:
            proposed[f"{kind}{sum(key.startswith(kind) for key in proposed)}"] = name
    if TIME not in proposed or "q0" not in proposed:
        return "Name them with diagnose.columns={t: NAME, q0: NAME, u0: NAME}"
    pairs = ", ".join(f"{key}: {name}" for key, name in proposed.items())
    return f"Name them, as diagnose.columns={{{pairs}}} if that is what they are"


def _kind_of(name: str) -> str | None:
    words = re.findall("[a-z]+", re.sub("([a-z])([A-Z])", r"\1 \2", name).lower())
    for kind, usual in USUAL.items():
        if words and (words[0] in usual or words[-1] in usual):
            return kind
    kinds = {word: kind for kind, usual in USUAL.items() for word in usual}
    near = difflib.get_close_matches("".join(words), kinds, n=1)
    return kinds[near[0]] if near else None


SEPARATORS = ",;\t"
KINDS = (".csv", ".txt", ".tsv", ".parquet", ".pq", ".npz", ".mat")


def read_table(path: Path) -> Table:
    """Read CSV (``.csv``, ``.txt``, ``.tsv``), Parquet (``.parquet``, ``.pq``), NPZ or MATLAB (``.mat``).

    In NPZ and MATLAB an array ``q``, ``v`` or ``u`` of shape (T, k) gives columns ``q0`` to ``q{k-1}``.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: another kind of file, a damaged one, or one without a header or without rows.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise ValueError(f"{path}: {kind or 'a file without suffix'} is no table; give one of {KINDS}")
    if kind == ".npz":
        table = _from_archive(path)
    elif kind == ".mat":
        table = _from_matlab(path)
    elif kind in (".parquet", ".pq"):
        table = _from_parquet(path)
    else:
        table = _from_text(path)
    if not len(table.lines):
        raise ValueError(f"{path}: no row of numbers below the header {list(table.columns)}; check the file")
    return table


def _from_text(path: Path) -> Table:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text in UTF-8 ({error}); save the table as CSV in UTF-8") from error
    if "\0" in text:
        raise ValueError(f"{path}: NUL bytes, as in UTF-16 or a damaged file; save the table as CSV in UTF-8")
    lines_of_text = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    every = [(number, line.strip(" ")) for number, line in enumerate(lines_of_text, 1)]
    uncommented = [(number, line.partition("#")[0].rstrip(" ")) for number, line in every]
    lines = [(number, line) for number, line in uncommented if line.strip()]
    if not lines:
        raise ValueError(f"{path}: empty; the first line names the columns: t,q0,q1,...")
    separator = max(SEPARATORS, key=lines[0][1].count)
    header = _cells(lines[0][1], separator)
    if all(_is_number(cell) for cell in header):
        # Some tools write the names in a comment above the numbers.
        above = [line.lstrip("# ") for number, line in every if number < lines[0][0] and line.startswith("#")]
        names = _cells(above[-1], separator) if above else []
        if len(names) != len(header):
            problem = f"numbers where the names of the columns should stand ({header})"
            raise ValueError(f"{path}, line {lines[0][0]}: {problem}; put t,q0,u0 or such above them")
        header, lines = names, [(0, ""), *lines]
    header = [name or f"(column {i})" for i, name in enumerate(header)]
    _refuse_twins(path, header)
    for number, line in lines[1:]:
        cells = line.count(separator) + 1
        if cells != len(header) and '"' not in line:
            problem = f"{cells} cells under {len(header)} names {header}"
            raise ValueError(f"{path}, line {number}: {problem}; give as many")
    body = "\n".join(line for _, line in lines[1:])
    decimal = "," if separator == ";" and re.search(r"\d,\d", body) else "."
    frame = pd.DataFrame(columns=header, dtype=float)
    if body:
        frame = pd.read_csv(
            io.StringIO(body),
            sep=separator,
            names=header,
            decimal=decimal,
            skipinitialspace=True,
            index_col=False,
            low_memory=False,
        )
    return Table(path.name, _plain(frame), np.array([number for number, _ in lines[1:]]), row="line")


def _from_parquet(path: Path) -> Table:
    try:
        frame = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: damaged or not a Parquet file ({error}); write it again") from error
    if any(frame.index.names):
        frame = frame.reset_index()
    frame.columns = pd.Index([str(name).strip() for name in frame.columns])
    _refuse_twins(path, list(frame.columns))
    return Table(path.name, _plain(frame), np.arange(len(frame)))


def _from_archive(path: Path) -> Table:
    arrays = _load_arrays(path)
    series = read_series(path, arrays, _load_arrays)
    if series is None:
        return _from_arrays(path, arrays)
    columns, named = series.name_columns()
    return Table(path.name, columns, np.arange(len(series.time_s)), named=named)


def _load_arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise ValueError(f"{path}: damaged, or holds Python objects ({error}); save plain arrays") from error


def _from_matlab(path: Path) -> Table:
    try:
        content = loadmat(path, chars_as_strings=True)
    except NotImplementedError as error:
        raise ValueError(f"{path}: MATLAB 7.3 is not read; save it with -v7, or as CSV") from error
    except (OSError, ValueError, TypeError, MatReadError) as error:
        raise ValueError(f"{path}: damaged or not a MATLAB file ({error}); save it with -v7") from error
    plain = {
        name: value
        for name, value in content.items()
        if not name.startswith("__") and value.dtype.kind in "fiub"
    }
    vectors = {name: value.reshape(-1) for name, value in plain.items() if value.size == max(value.shape) > 1}
    if not vectors:
        names = [name for name in content if not name.startswith("__")]
        raise ValueError(
            f"{path}: no numeric vector among {names}; save t and q as plain arrays, not in cells or structs"
        )
    n = len(vectors.get(TIME, next(iter(vectors.values()))))
    blocks = {name: plain[name] for name in ("q", "v", "u") if name in plain and name not in vectors}
    return _from_arrays(path, vectors | {name: v if len(v) == n else v.T for name, v in blocks.items()})


def _from_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> Table:
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.ndim == 2 and name in ("q", "v", "u"):
            columns |= {f"{name}{i}": array[:, i] for i in range(array.shape[1])}
        elif array.ndim == 1:
            columns[f"{name}0" if name in ("q", "v", "u") else name] = array
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{path}: arrays of different lengths {lengths}; give each one value a row")
    return Table(path.name, columns, np.arange(max(lengths.values(), default=0)))


def _refuse_twins(path: Path, header: list[str]) -> None:
    twins = sorted({name for name in header if header.count(name) > 1})
    if twins:
        raise ValueError(f"{path}: two columns are called {twins[0]!r} in {header}; rename one")


def _plain(frame: pd.DataFrame) -> dict[str, np.ndarray]:
    return {str(name): frame[name].to_numpy() for name in frame.columns}


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
