"""Read tables of numbers from CSV, Parquet, NPZ, MATLAB and HDF5."""

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from tokenize import TokenError

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from lagsplat.io.trajectory.columns import TIME, Table, list_arrays, refuse_twins
from lagsplat.io.trajectory.hdf5 import HDF5_SUFFIXES, read_hdf5
from lagsplat.io.trajectory.sysid_series import read_series
from lagsplat.io.trajectory.text import read_text
from lagsplat.processes import run_reader

NPZ_DAMAGE = (
    *(OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error, TokenError),
    *(
        NotImplementedError,
        RuntimeError,
        MemoryError,
    ),  # of its flags; of a length beyond any memory
)
"""What NumPy and zipfile raise on a damaged archive."""
KINDS = (".csv", ".txt", ".tsv", ".parquet", ".pq", ".npz", ".mat", *HDF5_SUFFIXES)


def read_table(path: Path, columns: Mapping[str, str] | None = None) -> Table:
    """Read CSV (``.csv``, ``.txt``, ``.tsv``), Parquet (``.parquet``, ``.pq``), NPZ, MATLAB or HDF5.

    In NPZ, MATLAB (``.mat``) and HDF5 an array ``q``, ``v`` or ``u`` of shape (T, k) gives columns ``q0`` to
    ``q{k-1}``. Of ``columns``, as in `name_columns`, HDF5 (``.h5``, ``.hdf5``) needs the time, which tells
    the rows.

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
    elif kind in HDF5_SUFFIXES:
        table = read_hdf5(path, columns or {})
    elif kind in (".parquet", ".pq"):
        table = _from_parquet(path)
    else:
        table = read_text(path)
    if not len(table.lines):
        raise ValueError(f"{path}: no row of numbers below the header {list(table.columns)}; check the file")
    return table


def _from_parquet(path: Path) -> Table:
    try:
        # Without what pandas notes beside the columns: an index is a column, and damaged notes are not read.
        frame = pq.read_table(path).to_pandas(ignore_metadata=True)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: damaged or not a Parquet file ({error}); write it again") from error
    frame.columns = pd.Index([str(name).strip() for name in frame.columns])
    frame = frame.loc[:, ~frame.columns.str.fullmatch(r"__index_level_\d+__")]
    refuse_twins(str(path), list(frame.columns))
    return Table(path.name, list_arrays(frame), np.arange(len(frame)))


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
    except NPZ_DAMAGE as error:
        raise ValueError(f"{path}: damaged, or holds Python objects ({error}); save plain arrays") from error


def _from_matlab(path: Path) -> Table:
    plain, names = _load_matlab(path)
    vectors = {name: value.reshape(-1) for name, value in plain.items() if value.size == max(value.shape) > 1}
    if not vectors:
        raise ValueError(
            f"{path}: no numeric vector among {names}; save t and q as plain arrays, not in cells or structs"
        )
    n = len(vectors.get(TIME, next(iter(vectors.values()))))
    blocks = {name: plain[name] for name in ("q", "v", "u") if name in plain and name not in vectors}
    return _from_arrays(path, vectors | {name: v if len(v) == n else v.T for name, v in blocks.items()})


READ_MATLAB = """
import io, json, sys
import numpy
from scipy.io import loadmat
content = {name: x for name, x in loadmat(sys.argv[1]).items() if not name.startswith("__")}
buffer = io.BytesIO()
names = [[name, x.dtype.kind in "fiub"] for name, x in content.items()]
numpy.savez(buffer, *[content[name] for name, is_numeric in names if is_numeric], names=json.dumps(names))
sys.stdout.buffer.write(buffer.getvalue())
"""


def _load_matlab(path: Path) -> tuple[dict[str, np.ndarray], list[str]]:
    """The numeric arrays of a MATLAB file, and the names of all that it holds."""
    try:
        content = run_reader(READ_MATLAB, str(path))  # SciPy's compiled reader may crash on a damaged file
    except ChildProcessError as error:
        told = error.strerror or f"its reader ends with {error.errno}"
        if "NotImplementedError" in told:
            raise ValueError(f"{path}: MATLAB 7.3 is not read; save it with -v7, or as CSV") from None
        raise ValueError(f"{path}: damaged or not a MATLAB file ({told}); save it with -v7") from None
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        names = json.loads(str(archive["names"]))
        numeric = [name for name, is_numeric in names if is_numeric]
        return {name: archive[f"arr_{i}"] for i, name in enumerate(numeric)}, [name for name, _ in names]


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
