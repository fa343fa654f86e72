"""Inputs that stand in a table of their own, beside a film that shows what they did."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lagsplat.io.motion_columns import TIME, counted, name_columns
from lagsplat.io.motion_table import read_table


def read_input_log(
    path: str | os.PathLike[str], *, columns: Mapping[str, str] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) [s] and inputs (N, n_u) of a table with columns ``t``, ``u0``, ``u1``, ...; rows without a
    number are left out with a warning.

    Raises:
        FileNotFoundError, ValueError: as `lagsplat.io.motion.read_motion`.
    """
    path = Path(path)
    table = name_columns(read_table(path), columns or {}, needed=(TIME, "u0"))
    names = (TIME, *counted(table, "u"))
    values = np.stack([table.numbers(name) for name in names], axis=1)
    whole = np.flatnonzero(np.isfinite(values).all(axis=1))
    if len(whole) < 2:
        raise ValueError(
            f"{table.source}: {len(whole)} row(s) with a number in every column; give two or more"
        )
    if len(whole) < len(values):
        warnings.warn(
            f"{table.source}: {len(values) - len(whole)} rows lack a number, left out", stacklevel=2
        )
    time_s = values[whole, 0]
    wrong = np.flatnonzero(np.diff(time_s) <= 0.0)
    if wrong.size:
        raise ValueError(
            f"{table.place(int(whole[wrong[0] + 1]))}: t does not increase, {time_s[wrong[0] + 1]:.9g} s "
            f"after {time_s[wrong[0]]:.9g} s; drop repeated rows"
        )
    return time_s, values[whole, 1:]
