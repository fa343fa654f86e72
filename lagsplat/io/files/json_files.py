"""Read and write JSON, CSV and the input columns of a CSV file, without pandas or torch."""

import csv
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.io.files.atomic import replace_atomically, write_text


def save_csv(path: str | os.PathLike[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write one line a row under a line of column names, those of the first row; None is an empty cell.

    Raises:
        ValueError: there is no row, or a row has a column that the first one lacks.
    """
    if not rows:
        raise ValueError(f"{path}: a table without a row has no columns")
    with replace_atomically(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def save_json(path: str | os.PathLike[str], content: Mapping[str, Any]) -> None:
    """Write plain data, indented, so that a difference between two runs can be read."""
    write_text(path, json.dumps(content, indent=1) + "\n")


def load_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Plain data written by `save_json`.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: the file is not JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: not JSON ({error}); delete it and run again") from error


def load_inputs(
    path: str | os.PathLike[str], *, dt_s: float
) -> tuple[Float64[np.ndarray, " N"], Float64[np.ndarray, "N n_u"]]:
    """Inputs from a CSV with columns ``t`` [s], ``u0``, ``u1``, ..., interpolated every ``dt_s``.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: a column is missing or not a number, or the times do not increase.
    """
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = [f"u{i}" for i in range(len(rows[0]) - 1)] if rows else []
    try:
        table = np.array([[float(row[name]) for name in ("t", *names)] for row in rows])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}; give numbers in columns t, u0, u1, ... and no others") from error
    if len(table) < 2 or not np.isfinite(table).all() or not (np.diff(table[:, 0]) > 0).all():
        raise ValueError(f"{path}: give at least two rows of finite numbers, with times t that increase")
    time_s = np.arange(table[0, 0], table[-1, 0] + 0.5 * dt_s, dt_s)
    columns = [np.interp(time_s, table[:, 0], column) for column in table[:, 1:].T]
    return time_s, np.stack(columns, axis=1) if columns else np.zeros((len(time_s), 0))
