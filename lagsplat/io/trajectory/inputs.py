"""Read inputs, pushes and initial states from tables, for simulations and for videos."""

import os
import warnings
from pathlib import Path

import numpy as np

from lagsplat.io.trajectory.columns import TIME, Table, count_names, name_columns
from lagsplat.io.trajectory.tables import read_table


def read_input_table(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s] (N,), inputs (N, n_u), pushes (N, n_f) of a table with ``t``, ``u0, ...`` and ``f0, ...``.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: no ``t``, an unknown column, a missing number, or times that do not increase.
    """
    table = read_table(Path(path))
    names = {letter: count_names(table, letter) for letter in "uf"}
    foreign = [name for name in table.columns if name not in (TIME, *names["u"], *names["f"])]
    if TIME not in table.columns or foreign:
        raise ValueError(
            f"{path}: columns {list(table.columns)}; give t [s], inputs u0, u1, ... and, where something "
            "pushes, accelerations f0, f1, ... by it, and no others"
        )
    time_s = _finite_block(table, (TIME,))[:, 0]
    _require_increasing(table, time_s, np.arange(len(time_s)))
    return time_s, _finite_block(table, names["u"]), _finite_block(table, names["f"])


def interpolate_inputs(
    time_s: np.ndarray, u: np.ndarray, *, dt_s: float, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Times every ``dt_s`` [s] (N,) from the first to the last, and inputs (N, n_u) linearly between rows.

    Raises:
        ValueError: there would be more than ``most`` samples.
    """
    span_s = time_s[-1] - time_s[0]
    if span_s > most * dt_s:
        raise ValueError(f"inputs over {span_s:.3g} s, of which {most * dt_s:.3g} can be simulated; cut them")
    even_s = np.arange(time_s[0], time_s[-1] + 0.5 * dt_s, dt_s)
    columns = [np.interp(even_s, time_s, column) for column in u.T]
    return even_s, np.stack(columns, axis=1) if columns else np.zeros((len(even_s), 0))


def read_input_log(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) [s] and inputs (N, n_u) of a table with columns ``t``, ``u0``, ``u1``, ...

    Rows with a missing number are dropped with a warning.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: a column is missing or not numeric, or times do not increase.
    """
    table = name_columns(read_table(Path(path)), {}, needed=(TIME, "u0"))
    values = table.block((TIME, *count_names(table, "u")))
    whole = np.flatnonzero(np.isfinite(values).all(axis=1))
    _require_increasing(table, values[whole, 0], whole)
    if len(whole) < len(values):
        lacking = len(values) - len(whole)
        warnings.warn(f"{table.source}: {lacking} rows lack a number, left out", stacklevel=2)
    return values[whole, 0], values[whole, 1:]


def read_initial_state(text: str, d: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and rates (d,) from ``q0,..,v0,..`` or from the first row of a table with such columns.

    Missing rates are zero.

    Raises:
        FileNotFoundError: the table does not exist.
        ValueError: the wrong count of numbers, or text that is no number.
    """
    try:
        numbers = [float(word) for word in text.strip("[]()").split(",")]
    except ValueError:
        table = read_table(Path(text))
        names = (*count_names(table, "q"), *count_names(table, "v"))
        numbers = _finite_block(table, names)[0].tolist()
    if len(numbers) not in (d, 2 * d) or not np.isfinite(numbers).all():
        wanted = f"the sim has {d} coordinate(s); give {d}, or {2 * d} with the rates"
        raise ValueError(f"initial={text}: {len(numbers)} number(s) {numbers}; {wanted}")
    state = np.array(numbers + [0.0] * (2 * d - len(numbers)))
    return state[:d], state[d:]


def _finite_block(table: Table, names: tuple[str, ...]) -> np.ndarray:
    block = table.block(names)
    bad = np.argwhere(~np.isfinite(block))
    if bad.size:
        row, column = bad[0]
        raise ValueError(f"{table.place(int(row))}: {names[column]} is missing or not finite; fill it in")
    return block


def _require_increasing(table: Table, time_s: np.ndarray, rows: np.ndarray) -> None:
    """Check the times [s] in these ``rows`` of the table: two or more, and increasing."""
    if len(rows) < 2:
        raise ValueError(
            f"{table.source}: {len(rows)} row(s) with a number in every column; give two or more"
        )
    wrong = np.flatnonzero(np.diff(time_s) <= 0.0)
    if wrong.size:
        before, after = wrong[0], wrong[0] + 1
        order = f"{time_s[after]:.9g} s after {time_s[before]:.9g} s"
        raise ValueError(f"{table.place(int(rows[after]))}: t does not increase, {order}; drop repeated rows")
