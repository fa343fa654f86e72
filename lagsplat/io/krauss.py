"""Recordings of the pneumatic arms of Krauss et al.: an NPZ archive with images and chamber pressures.

Keys: ``images`` (T, 3, H, W), RGB, uint8 or floating point in [0, 1]; ``p1`` to ``pn`` (T,), chamber
pressures [atm], one value per frame. The archive has no times; the published ones run at 60000/1001 frames
per second. Images are read in chunks, so memory holds little more than the uint8 frames.
"""

import math
import re
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import cast

import numpy as np
from jaxtyping import Float64, UInt8

from lagsplat.io.files.atomic import StrPath, sha256_of
from lagsplat.io.recording.recording import Recording

CHUNK_BYTES = 2**24
REPAIR = "fetch it again, or name another file with recording.path=FILE"


def read_krauss_npz(path: StrPath, *, dt_s: float, expected_inputs: int) -> Recording:
    """Read the NPZ archive at ``path`` as one clip with a frame every ``dt_s`` seconds.

    Floating-point images become uint8. Multiples of 1/255, as published, lose nothing; otherwise a warning
    gives the largest change. Entirely black frames cause a warning.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the archive is truncated, a key is missing or of the wrong shape, a value is not a number
            or outside its range, or there are not ``expected_inputs`` pressures.

    Source: DOI 10.5281/zenodo.17812071
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check recording.path")
    try:
        with zipfile.ZipFile(path) as archive:
            names = _pressure_names(path, archive, expected_inputs)
            frames = _read_frames(path, archive)
            columns = [_read_pressure(path, archive, name, len(frames)) for name in names]
    # NotImplementedError: a compression that zipfile lacks. RuntimeError: an encrypted member.
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
        MemoryError,
    ) as error:
        raise ValueError(f"{path}: truncated or not an NPZ archive ({error}); {REPAIR}") from error
    return Recording(
        frames=frames,
        time_s=dt_s * np.arange(len(frames)),
        inputs=np.stack(columns, axis=1) if columns else np.zeros((len(frames), 0)),
        input_names=names,
        input_units=("atm",) * len(names),
        meta={"origin": "filmed", "source": path.name, "sha256": sha256_of(path), "licence": "unknown"},
    )


def _pressure_names(path: Path, archive: zipfile.ZipFile, expected: int) -> tuple[str, ...]:
    keys = {name.removesuffix(".npy") for name in archive.namelist()}
    if "images" not in keys:
        raise ValueError(f"{path}: no key 'images', only {sorted(keys)}; {REPAIR}")
    numbers = sorted(int(key[1:]) for key in keys if re.fullmatch("p[1-9][0-9]*", key))
    if numbers != list(range(1, expected + 1)):
        raise ValueError(
            f"{path}: pressure channels {[f'p{n}' for n in numbers]}, but the system has {expected}, from "
            "'p1' on without a hole. Check system= and recording.path="
        )
    return tuple(f"p{number}" for number in numbers)


@dataclass(frozen=True)
class _StoredArray:
    """An array of the archive, read up to its header."""

    stream: zipfile.ZipExtFile
    shape: tuple[int, ...]
    column_major: bool
    dtype: np.dtype


@contextmanager
def _open_array(path: Path, archive: zipfile.ZipFile, key: str) -> Iterator[_StoredArray]:
    with cast(zipfile.ZipExtFile, archive.open(f"{key}.npy")) as stream:
        try:
            major, _ = np.lib.format.read_magic(stream)
            readers = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}
            array = _StoredArray(stream, *readers[major](stream))
        except (ValueError, KeyError, TokenError) as error:
            raise ValueError(f"{path}: key {key!r} is not a plain NumPy array ({error}); {REPAIR}") from error
        if array.dtype.hasobject:
            raise ValueError(
                f"{path}: key {key!r} holds Python objects, which could execute code; save numbers"
            )
        yield array


def _chunks(path: Path, key: str, array: _StoredArray) -> Iterator[np.ndarray]:
    """Successive rows of an array, `CHUNK_BYTES` or a row at a time."""
    shape, dtype = array.shape, array.dtype
    per_row = max(1, math.prod(shape[1:])) * dtype.itemsize
    # In column-major order each frame is scattered over the member, so that it cannot be streamed.
    rows = shape[0] if array.column_major else max(1, CHUNK_BYTES // per_row)
    for start in range(0, shape[0], rows):
        n = min(rows, shape[0] - start)
        data = array.stream.read(n * per_row)
        if len(data) < n * per_row:
            raise ValueError(f"{path}: key {key!r} ends {n * per_row - len(data)} bytes early; {REPAIR}")
        values = np.frombuffer(data, dtype)
        yield values.reshape(shape[::-1]).T if array.column_major else values.reshape(n, *shape[1:])


def _read_frames(path: Path, archive: zipfile.ZipFile) -> UInt8[np.ndarray, "T H W 3"]:
    with _open_array(path, archive, "images") as images:
        shape, dtype = images.shape, images.dtype
        if len(shape) != 4 or shape[1] != 3 or 0 in shape:
            hint = "channels come second, not last" if shape[-1:] == (3,) else "colour pictures are needed"
            raise ValueError(f"{path}: 'images' has shape {shape}, not (T, 3, H, W); {hint}")
        if dtype != np.uint8 and dtype.kind != "f":
            raise ValueError(f"{path}: 'images' has dtype {dtype}; store uint8, or floating point in [0, 1]")
        frames = np.empty((shape[0], shape[2], shape[3], 3), np.uint8)
        start, change = 0, 0.0
        for chunk in _chunks(path, "images", images):
            change = max(change, _store(path, chunk, frames[start : start + len(chunk)], start))
            start += len(chunk)
    # A low-precision float cannot represent a multiple of 1/255 more closely than this.
    if dtype.kind == "f" and change > max(0.01, 255.0 * float(np.finfo(dtype).eps)):
        problem = f"rounding to uint8 changed them by up to {change:.2f} of a grey level"
        warnings.warn(f"{path}: 'images' are not multiples of 1/255; {problem}", stacklevel=3)
    if black := int((~frames.reshape(len(frames), -1).any(axis=1)).sum()):
        warnings.warn(f"{path}: {black} of {len(frames)} frames are entirely black", stacklevel=3)
    return frames


def _store(path: Path, chunk: np.ndarray, out: np.ndarray, first: int) -> float:
    """Copy ``chunk`` (n, 3, H, W) to ``out`` (n, H, W, 3); return the largest rounding [grey level]."""
    if chunk.dtype == np.uint8:
        out[:] = chunk.transpose(0, 2, 3, 1)
        return 0.0
    low, high = float(chunk.min()), float(chunk.max())
    if not (low >= 0.0 and high <= 1.0):  # true for NaN, too
        with np.errstate(invalid="ignore"):
            bad = np.argwhere(~((chunk >= 0.0) & (chunk <= 1.0)))[0]
        place = f"frame {first + bad[0]}, channel {bad[1]}, row {bad[2]}, column {bad[3]}"
        raise ValueError(
            f"{path}: 'images' holds {chunk[tuple(bad)]} at {place}; floating-point colours lie in [0, 1]. "
            "Divide by 255, or store uint8"
        )
    scaled = 255.0 * chunk.astype(np.float32, copy=False)
    rounded = np.rint(scaled)
    out[:] = rounded.transpose(0, 2, 3, 1)
    return float(np.abs(scaled - rounded).max())


def _read_pressure(
    path: Path, archive: zipfile.ZipFile, key: str, n_frames: int
) -> Float64[np.ndarray, " T"]:
    with _open_array(path, archive, key) as array:
        if array.shape != (n_frames,) or array.dtype.kind not in "fiu":
            problem = f"shape {array.shape} and dtype {array.dtype}, but there are {n_frames} images"
            raise ValueError(f"{path}: {key!r} has {problem}; give one pressure [atm] a frame, ({n_frames},)")
        values = np.concatenate(list(_chunks(path, key, array))).astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        problem = f"{values[bad[0]]} at frame {bad[0]} ({bad.size} such values)"
        raise ValueError(f"{path}: {key!r} is {problem}; fill the gap or cut the recording there")
    return values
