"""Plain files that people read: CSV and JSON, each written whole or not at all."""

import csv
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lagsplat.io.atomic import replacing, write_text


def save_csv(path: str | os.PathLike[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write one line a row under a line of column names, those of the first row; None is an empty cell.

    Raises:
        ValueError: there is no row, or a row has a column that the first one lacks.
    """
    if not rows:
        raise ValueError(f"{path}: a table without a row has no columns")
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
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
