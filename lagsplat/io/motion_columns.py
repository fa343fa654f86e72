"""Which column of a table is time, coordinate, rate or input: by name alone, never by guess."""

import difflib
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

from lagsplat.io.motion_table import Table

TIME, SEGMENT = "t", "segment"
CONTRACT = "t [s], q0, q1, ..., optionally v0, ..., u0, ... and segment"
USUAL = {
    "t": ("t", "time", "timestamp", "stamp", "sec", "seconds", "zeit"),
    "q": ("q", "pos", "position", "angle", "theta", "phi", "x", "y", "disp", "displacement", "qpos"),
    "v": ("v", "vel", "velocity", "omega", "rate", "speed", "qvel", "dq", "dtheta"),
    "u": ("u", "tau", "torque", "force", "input", "cmd", "command", "ctrl", "pressure", "p", "voltage"),
    "segment": ("segment", "clip", "trial", "episode", "release", "run"),
}
"""What other tools call such columns: used to propose a setting, never to read one."""


def name_columns(table: Table, columns: Mapping[str, str], *, needed: Sequence[str] = (TIME, "q0")) -> Table:
    """The table under the names of the contract; ``columns`` maps these to the file's own.

    Columns of other names are left out, with a warning that lists them.

    Raises:
        ValueError: a name that is none of the contract's, a column that the file lacks, or one of ``needed``
            that is missing; the message lists the columns found and proposes the setting that is nearest.
    """
    found = list(table.columns)
    for name, own in columns.items():
        if not _is_contract(name):
            raise ValueError(f"diagnose.columns names {name!r}; only {CONTRACT} are known")
        if own not in table.columns:
            near = difflib.get_close_matches(own, found, n=1, cutoff=0.0)
            raise ValueError(
                f"{table.source}: no column {own!r} for {name}, only {found}; did you mean {near[0]!r}?"
            )
    taken = set(columns.values())
    named = {name: table.columns[name] for name in found if _is_contract(name) and name not in taken}
    named |= {name: table.columns[own] for name, own in columns.items()}
    missing = [name for name in needed if name not in named]
    if missing:
        raise ValueError(
            f"{table.source}: no column {' and no '.join(missing)}; the columns are {found}, and "
            f"{CONTRACT} are needed. {_proposal(found)}"
        )
    left = [name for name in found if name not in named and name not in taken]
    if left:
        warnings.warn(
            f"{table.source}: column(s) {', '.join(left[:8])}{', ...' if len(left) > 8 else ''} are not "
            "used; diagnose.columns={u0: NAME} would name one an input",
            stacklevel=3,
        )
    return replace(table, columns=named)


def counted(table: Table, letter: str) -> tuple[str, ...]:
    """The columns ``letter0, letter1, ...`` of a table under the names of the contract, in that order.

    Raises:
        ValueError: a number is left out, or rates are given of some coordinates only.
    """
    numbers = sorted(int(name[1:]) for name in table.columns if re.fullmatch(f"{letter}[0-9]+", name))
    wanted = set(range(len(numbers)))
    if letter == "v" and numbers:
        wanted = set(range(len(counted(table, "q"))))
    if set(numbers) != wanted:
        have = [f"{letter}{number}" for number in numbers]
        lack = [f"{letter}{number}" for number in sorted(wanted - set(numbers))]
        remedy = f"{lack} are missing" if lack else f"only {len(wanted)} coordinates have a rate"
        raise ValueError(f"{table.source}: columns {have}, but {remedy}; count from {letter}0 without holes")
    return tuple(f"{letter}{number}" for number in numbers)


def _is_contract(name: str) -> bool:
    return name in (TIME, SEGMENT) or re.fullmatch("[quv](0|[1-9][0-9]*)", name) is not None


def _proposal(found: list[str]) -> str:
    """The setting that would read this file, as far as its names tell."""
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
    near = difflib.get_close_matches(
        "".join(words), [word for usual in USUAL.values() for word in usual], n=1
    )
    return next((kind for kind, usual in USUAL.items() if near and near[0] in usual), None)
