"""Columns of a table of numbers: found by name, never by guess."""

import difflib
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from lagsplat.io.config import CLOCKS

TIME, SEGMENT, NUMBER = "t", "segment", "(0|[1-9][0-9]*)"
STANDARD = "t [s], q0, q1, ..., optionally v0, ..., u0, ... and segment"
USUAL = {
    "t": ("t", "time", "timestamp", "stamp", "sec", "seconds", "zeit"),
    "q": ("q", "pos", "position", "angle", "theta", "phi", "x", "y", "disp", "displacement", "qpos"),
    "v": ("v", "vel", "velocity", "omega", "rate", "speed", "qvel", "dq", "dtheta"),
    "u": (
        "u",
        "tau",
        "torque",
        "force",
        "input",
        "cmd",
        "command",
        "ctrl",
        "pressure",
        "p",
        "voltage",
        "action",
        "actions",
    ),
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
            return column.astype(np.float64, copy=False)
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


def propose_names(found: Sequence[str]) -> dict[str, str]:
    """The standard names that columns most likely have, judged by their own names."""
    proposed: dict[str, str] = {}
    for name in found:
        kind = _kind_of(name)
        if kind in (TIME, SEGMENT):
            proposed.setdefault(kind, name)
        elif kind:
            proposed[f"{kind}{sum(key.startswith(kind) for key in proposed)}"] = name
    return proposed


def _proposal(found: list[str]) -> str:
    """The most likely setting that would read this file."""
    proposed = propose_names(found)
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


def refuse_twins(source: str, header: Sequence[str]) -> None:
    """Raise a ValueError that names ``source`` if two columns have one name."""
    twins = sorted({name for name in header if list(header).count(name) > 1})
    if twins:
        raise ValueError(f"{source}: two columns are called {twins[0]!r} in {header}; rename one")


def list_arrays(frame: pd.DataFrame) -> dict[str, np.ndarray]:
    """The columns of a frame as arrays."""
    return {str(name): frame[name].to_numpy() for name in frame.columns}
