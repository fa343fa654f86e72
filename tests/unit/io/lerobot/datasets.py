"""Numbers of the datasets of `make_data`, and how a test changes them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
NAMES = tuple(f"{joint}.pos" for joint in JOINTS)


def rows_of(folder: Path) -> pa.Table:
    return pa.concat_tables(pq.read_table(file) for file in sorted(folder.glob("data/*/*.parquet")))


def block(rows: pa.Table, name: str) -> np.ndarray:
    return np.array(rows[name].to_pylist())


def change_info(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    info = json.loads((folder / "meta/info.json").read_text())
    change(info)
    (folder / "meta/info.json").write_text(json.dumps(info))


def rewrite(file: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    pq.write_table(change(pq.read_table(file)), file)


def set_column(table: pa.Table, name: str, values: Any) -> pa.Table:
    return table.set_column(table.column_names.index(name), name, values)


def scale(folder: Path, factor: float) -> None:
    """All joints by a factor, so that another rule tells their unit."""
    for file in folder.glob("data/*/*.parquet"):
        for name in ("action", "observation.state"):
            scaled = [[factor * value for value in row] for row in pq.read_table(file)[name].to_pylist()]
            kind = pq.read_table(file).schema.field(name).type
            rewrite(file, lambda table, n=name, s=scaled, k=kind: set_column(table, n, pa.array(s, k)))
