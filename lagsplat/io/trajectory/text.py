"""Read a table from a text: commas, semicolons or tabs, remarks after ``#``, names in the first line.

PyArrow parses what is tidy. What it refuses is read again line by line, which finds the place of the fault or
reads what PyArrow is too strict for.
"""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as arrow_csv

from lagsplat.io.trajectory.columns import Table, list_arrays, refuse_twins

SEPARATORS = ",;\t"
MISSING = ("", "NaN", "nan", "-NaN", "-nan", "NA", "N/A", "n/a", "<NA>", "null", "NULL", "None")
"""How a missing number is written."""
TRUTHS = ("true", "false")
MARK = b"\xef\xbb\xbf"  # byte-order mark of UTF-8


@dataclass(frozen=True)
class _Head:
    """Names of the columns, what separates them, and where the rows begin."""

    names: list[str]
    separator: str
    start: int  # of the rows [byte]
    line: int  # number of the first row's line


def read_text(path: Path) -> Table:
    """Read the table in the text file at ``path``; rows are counted by their lines.

    Raises:
        ValueError: the text is not in UTF-8, empty or without names, two columns have one name, or a row has
            another number of cells than there are names.
    """
    content = _read_lines(path)
    head = _read_head(path, content)
    body = content[head.start :]
    del content  # of a long log, half the memory
    if b"#" in body:
        body = re.sub(rb"#[^\n]*", b"", body)
    if b"\n " in body or b"\n\t" in body or body[:1] in (b" ", b"\t"):
        body = re.sub(rb"(?m)^[ \t]+$", b"", body)
    columns = _parse_tidy(body, head)
    if columns is None:
        return _parse_lines(path, body, head)
    rows = len(next(iter(columns.values())))
    return Table(path.name, columns, _number_lines(body, head.line, rows), row="line")


def _read_lines(path: Path) -> bytes:
    """The text without a byte-order mark, its lines ending with LF."""
    content = path.read_bytes().removeprefix(MARK)
    if not content.isascii():
        try:
            content.decode("utf-8")
        except UnicodeDecodeError as error:
            problem = f"not a text in UTF-8 ({error})"
            raise ValueError(f"{path}: {problem}; save the table as CSV in UTF-8") from error
    if b"\0" in content:
        raise ValueError(f"{path}: NUL bytes, as in UTF-16 or a damaged file; save the table as CSV in UTF-8")
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content


def _read_head(path: Path, content: bytes) -> _Head:
    start, line, above = 0, 1, ""
    while start < len(content):
        stop = content.find(b"\n", start)
        stop = len(content) if stop < 0 else stop
        text = content[start:stop].decode("utf-8").strip(" ")
        named = text.partition("#")[0].rstrip(" ")
        if named.strip():
            break
        above = text if text.startswith("#") else above
        start, line = stop + 1, line + 1
    else:
        raise ValueError(f"{path}: empty; the first line names the columns: t,q0,q1,...")
    separator = max(SEPARATORS, key=named.count)
    header = _split(named, separator)
    if all(_is_number(cell) for cell in header):
        # Some tools write the names in a comment above the numbers.
        names = _split(above.lstrip("# "), separator) if above else []
        if len(names) != len(header):
            problem = f"numbers where the names of the columns should stand ({header})"
            raise ValueError(f"{path}, line {line}: {problem}; put t,q0,u0 or such above them")
        header = names
    else:
        start, line = stop + 1, line + 1
    header = [name or f"(column {i})" for i, name in enumerate(header)]
    refuse_twins(str(path), header)
    return _Head(header, separator, start, line)


def _parse_tidy(body: bytes, head: _Head) -> dict[str, np.ndarray] | None:
    """The columns, by name; None if a row or a cell is not of the form of the first."""
    first = next((line for line in io.BytesIO(body) if line.strip()), b"").decode("utf-8").strip(" \n")
    cells = _split(first, head.separator) if first.strip() else []
    if len(cells) != len(head.names) or any(cell.lower() in TRUTHS for cell in cells):
        return None
    decimal = _decimal(body, head)
    numeric = [cell in MISSING or _is_number(cell.replace(decimal, ".")) for cell in cells]
    words = pa.dictionary(pa.int32(), pa.string())
    kinds = dict(
        zip(head.names, [pa.float64() if is_number else words for is_number in numeric], strict=True)
    )
    try:
        table = arrow_csv.read_csv(
            pa.BufferReader(body),
            read_options=arrow_csv.ReadOptions(column_names=head.names),
            parse_options=arrow_csv.ParseOptions(delimiter=head.separator),
            convert_options=arrow_csv.ConvertOptions(
                column_types=kinds,
                null_values=list(MISSING),
                strings_can_be_null=True,
                decimal_point=decimal,
            ),
        )
    except pa.ArrowInvalid:
        return None
    return {
        name: table[name].to_numpy() if kinds[name] == pa.float64() else _spell(table[name])
        for name in head.names
    }


def _spell(column: pa.ChunkedArray) -> np.ndarray:
    """Words of a dictionary as objects, NaN where one is missing."""
    merged = column.unify_dictionaries().combine_chunks()
    parts = merged.chunks if isinstance(merged, pa.ChunkedArray) else [merged]
    spelled = [
        np.array([*part.dictionary.to_pylist(), np.nan], dtype=object)[part.indices.fill_null(-1).to_numpy()]
        for part in parts
    ]
    return np.concatenate(spelled)


def _number_lines(body: bytes, first: int, rows: int) -> np.ndarray:
    """Numbers of the lines that are rows, where empty lines are none."""
    lines = body.count(b"\n") + (not body.endswith(b"\n"))
    if lines == rows:
        return np.arange(first, first + rows)
    ends = np.flatnonzero(np.frombuffer(body + b"\n", np.uint8) == ord("\n"))
    return first + np.flatnonzero(np.diff(ends, prepend=-1) > 1)


def _parse_lines(path: Path, body: bytes, head: _Head) -> Table:
    every = enumerate(body.decode("utf-8").split("\n"), head.line)
    lines = [(number, line.strip(" ")) for number, line in every if line.strip()]
    for number, line in lines:
        cells = line.count(head.separator) + 1
        if cells != len(head.names) and '"' not in line:
            problem = f"{cells} cells under {len(head.names)} names {head.names}"
            raise ValueError(f"{path}, line {number}: {problem}; give as many")
    frame = pd.DataFrame(columns=head.names, dtype=float)
    if lines:
        frame = pd.read_csv(
            io.StringIO("\n".join(line for _, line in lines)),
            sep=head.separator,
            names=head.names,
            decimal=_decimal(body, head),
            skipinitialspace=True,
            index_col=False,
            low_memory=False,
        )
    return Table(path.name, list_arrays(frame), np.array([number for number, _ in lines]), row="line")


def _decimal(body: bytes, head: _Head) -> str:
    return "," if head.separator == ";" and re.search(rb"\d,\d", body) else "."


def _split(line: str, separator: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
