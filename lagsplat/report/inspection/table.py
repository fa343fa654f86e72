"""What a table of numbers holds, in words, how it would be read, and the command that uses it."""

import shlex
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lagsplat.io.trajectory.columns import Table, name_columns, propose_names
from lagsplat.io.trajectory.tables import read_table
from lagsplat.io.trajectory.trajectory import Trajectory, make_trajectory
from lagsplat.report.inspection.words import pair_columns, write_columns

MAX_LISTED = 24


def describe_table(path: Path, columns: Mapping[str, str]) -> str:
    """Describe the columns of a table, the trajectory in it, and the command that reads it.

    ``columns`` maps standard names to the table's own; without it they are guessed where they are not there.

    Raises:
        FileNotFoundError, ValueError: as `lagsplat.io.trajectory.tables.read_table`.
    """
    table = read_table(path, columns)
    names = list(table.columns)
    lines = [f"source     {path.name}, {len(table.lines)} rows"]
    lines += [f"column     {_describe_column(table, name)}" for name in names[:MAX_LISTED]]
    lines += [f"           and {len(names) - MAX_LISTED} more"] if len(names) > MAX_LISTED else []
    guessed = not columns and not {"t", "q0"} <= {*names, *table.named}
    mapping = propose_names([name for name in names if _find_range(table, name)]) if guessed else columns
    mapping = {key: name for key, name in mapping.items() if key != name}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            lines += _describe_motion(make_trajectory(name_columns(table, mapping), source=path.name))
        except ValueError as error:
            lines.append(f"unreadable {error}")
    lines += [f"warning    {warning.message}" for warning in caught]
    words = [
        "lagsplat",
        "diagnose",
        "sim=SIM",
        f"real={path}",
        *([write_columns(mapping)] if mapping else []),
    ]
    if guessed:
        guess = pair_columns(mapping) or "none"
        lines.append(f"guess      {guess}, from the names alone; correct what is not so")
    return "\n".join([*lines, f"to use it  {shlex.join(words)}"])


def _describe_column(table: Table, name: str) -> str:
    found = _find_range(table, name)
    if found is None:
        return f"{name}: no numbers, not read"
    low, high, missing = found
    told = f"{low:.6g} to {high:.6g}" if low < high else f"{low:.6g} throughout"
    return f"{name}: {told}" + (f", {missing} missing" if missing else "")


def _find_range(table: Table, name: str) -> tuple[float, float, int] | None:
    """Least and largest number of a column, and how many are missing; None of one without numbers."""
    try:
        values = table.numbers(name)
    except ValueError:
        return None
    present = values[np.isfinite(values)]
    if not len(present):
        return None
    return float(present.min()), float(present.max()), len(values) - len(present)


def _describe_motion(motion: Trajectory) -> list[str]:
    rates = "" if motion.v is None else " with rates"
    return [
        f"read as    {motion.d} coordinate(s){rates}, {motion.n_u} input(s), {len(motion.segments)} clip(s)",
        f"duration   {motion.duration_s:.6g} s, {1.0 / motion.dt_s:.6g} samples/s",
    ]
