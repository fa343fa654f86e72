"""The artifact: one file that holds tensors and a header with what made them.

Format, version 1.

1. An artifact is one valid ``.safetensors`` file: a table of offsets and raw bytes. Reading it cannot run
   code, and every tensor can be mapped into memory at its offset. A pickle can do neither.
2. Its ``__metadata__`` has the key ``lagsplat``, whose value is one JSON object, the header: a single file
   cannot lose its settings.
3. The header has ``kind`` (text: what the file is) and ``schema`` (integer: version of that kind), so that a
   chart passed as dynamics is refused by name; and ``stamp`` (commit, versions, platform, time), added on
   writing if absent, so that a result can be traced to what made it.
4. The header has everything needed to use the tensors (time unit, whitening, resolved config). With today's
   config, an old result would silently become another system.
5. Tensors are little-endian, C-contiguous, of the dtypes in ``DTYPES``; names are free.
6. In the header NaN and infinities are the bare words Python's ``json`` writes, tuples become lists, NumPy
   scalars and arrays become plain numbers and lists.
7. A file is written beside its target, forced to the disk and renamed: one that exists is complete.
8. The header's first member is ``"checked": "xxh3"``. The last one, ``xxh3``, holds the XXH3 checksums of the
   header without it and of each tensor with its dtype and shape. They are compared on every opening, so a bit
   that flipped on a disk or in a copy is an error. Files that were written before this was so have neither
   member; they open unchecked.
"""

import json
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import xxhash
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from lagsplat.io.files.atomic import StrPath, replace_atomically
from lagsplat.provenance import stamp

if TYPE_CHECKING:
    import torch

KEY = "lagsplat"
# In the header itself: the library writes several keys in an order that changes from process to process.
CHECKED, CHECKSUMS = '{"checked": "xxh3", ', ', "xxh3": '
DTYPES = {
    "F64": np.float64,
    "F32": np.float32,
    "F16": np.float16,
    "I64": np.int64,
    "I32": np.int32,
    "I16": np.int16,
    "I8": np.int8,
    "U64": np.uint64,
    "U32": np.uint32,
    "U16": np.uint16,
    "U8": np.uint8,
    "BOOL": np.bool_,
}


def save_artifact(path: StrPath, tensors: Mapping[str, Any], header: Mapping[str, Any]) -> None:
    """Write ``tensors`` (NumPy, or torch on any device) and ``header`` to ``path``, atomically.

    Raises:
        ValueError: ``kind`` or ``schema`` is missing, the header is not JSON, or a dtype is not portable.
        OSError: the file cannot be written; an earlier file at ``path`` is unchanged.
    """
    arrays = {name: _as_array(name, tensor) for name, tensor in tensors.items()}
    if not isinstance(header.get("kind"), str) or not isinstance(header.get("schema"), int):
        keys = f"kind = {header.get('kind')!r} and schema = {header.get('schema')!r}"
        raise ValueError(f"{path}: the header has {keys}; give kind as text and schema as an integer")
    stamped = {**header, "stamp": header["stamp"] if "stamp" in header else stamp()}
    try:
        text = json.dumps(stamped, default=_plain)
    except (TypeError, ValueError) as error:
        message = f"{path}: the header is not JSON ({error}); keep to numbers, text, lists and dicts"
        raise ValueError(message) from error
    text = CHECKED + text[1:]
    sums = {name: checksum_of(array) for name, array in arrays.items()}
    checksums = json.dumps({"header": xxhash.xxh3_64_hexdigest(text.encode()), "tensors": sums})
    with replace_atomically(path) as temporary:
        save_file(arrays, temporary, metadata={KEY: f"{text[:-1]}{CHECKSUMS}{checksums}}}"})


def load_artifact(
    path: StrPath, *, kind: str | None = None, schema: int | None = None, mapped: Collection[str] = ()
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Load the tensors and the header of the artifact at ``path``; ``kind`` and ``schema`` as `read_header`.

    The tensors named in ``mapped`` are read-only memory maps; the others are copies. Every tensor is read
    once and compared with its checksum, if the file has checksums.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is truncated, damaged, foreign, of another kind or schema, or lacks a tensor.
    """
    header, checksums = _read_metadata(path, kind, schema)
    # The library's NumPy interface returns copies, so for memory maps the table of offsets is read here:
    # eight bytes of length, little-endian, then that many bytes of JSON. `read_header` has checked it.
    with open(path, "rb") as file:
        length = int.from_bytes(file.read(8), "little")
        layout = json.loads(file.read(length))
    layout.pop("__metadata__", None)
    missing = sorted(set(mapped) - set(layout))
    if missing:
        raise ValueError(f"{path}: no tensor {missing[0]!r}, only {sorted(layout)}; other code made the file")
    arrays: dict[str, np.ndarray] = {}
    for name, entry in layout.items():
        if entry["dtype"] not in DTYPES:
            raise ValueError(f"{path}: dtype {entry['dtype']} is unknown to NumPy; save it as F32 or F64")
        dtype, shape = np.dtype(DTYPES[entry["dtype"]]).newbyteorder("<"), tuple(entry["shape"])
        begin, end = entry["data_offsets"]
        if begin == end:  # an empty range cannot be mapped
            array = np.empty(shape, dtype)
        else:
            view = np.memmap(path, dtype, "r", offset=8 + length + begin, shape=shape)
            array = view if name in mapped else np.array(view)
        if checksums is not None and checksum_of(array) != checksums.get(name):
            raise _damaged(path, f"tensor {name!r}")
        arrays[name] = array
    if checksums is not None and (lost := sorted(set(checksums) - set(arrays))):
        raise _damaged(path, f"tensor {lost[0]!r}")
    return arrays, header


def read_header(path: StrPath, *, kind: str | None = None, schema: int | None = None) -> dict[str, Any]:
    """Read only the header of the artifact at ``path``; it must have this ``kind`` and ``schema``, if given.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is truncated, damaged, foreign, or of another kind or schema.
    """
    return _read_metadata(path, kind, schema)[0]


def require_settings(
    path: StrPath, header: Mapping[str, Any], stored: Collection[str], names: Collection[str]
) -> None:
    """Refuse a file of which ``header`` is read where the settings ``stored`` in it are not these ``names``.

    Raises:
        ValueError: one is lacking, or unknown to this version.
    """
    lacking, unknown = sorted(set(names) - set(stored)), sorted(set(stored) - set(names))
    if lacking or unknown:
        stamped = header.get("stamp", {})
        wrong = f"has no {', '.join(lacking)}" if lacking else f"has an unknown {', '.join(unknown)}"
        raise ValueError(
            f"{path}: {header['kind']!r} {wrong}; version {stamped.get('version')}, commit "
            f"{stamped.get('commit')}, wrote it. Make the file again, or use the version that made it"
        )


def _read_metadata(
    path: StrPath, kind: str | None, schema: int | None
) -> tuple[dict[str, Any], dict[str, str] | None]:
    """The header, and the checksums of the tensors; None in a file that was written without them."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such file; make it first, or check the path")
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
    except SafetensorError as error:
        raise ValueError(
            f"{path}: not a whole safetensors file ({error}); it is truncated or something else. "
            "Delete it and run again, or fetch it again"
        ) from error
    if KEY not in metadata:
        raise ValueError(f"{path}: its metadata has no {KEY!r} header; another program wrote it")
    text, checksums = _split_checksums(path, metadata[KEY])
    try:
        header = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: its {KEY!r} header is not JSON ({error}); make it again") from error
    if not isinstance(header, dict) or not isinstance(header.get("kind"), str):
        raise ValueError(f"{path}: its {KEY!r} header names no kind; the file was made by other code")
    if kind is not None and header["kind"] != kind:
        raise ValueError(f"{path}: holds a {header['kind']!r}, but a {kind!r} is wanted; check its name")
    if schema is not None and header.get("schema") != schema:
        raise ValueError(
            f"{path}: {header['kind']!r} of schema {header.get('schema')}, but this version reads schema "
            f"{schema}; make the file again, or use the version that made it"
        )
    return header, checksums


def _split_checksums(path: StrPath, written: str) -> tuple[str, dict[str, str] | None]:
    """The header without its checksums, and the checksums of the tensors."""
    text, mark, checksums = written.rpartition(CHECKSUMS)
    if not mark and not written.startswith(CHECKED):
        return written, None
    text += "}"  # without the mark it is empty, and so are the checksums
    try:
        sums = json.loads(checksums[:-1])
        of_header, of_tensors = sums["header"], dict(sums["tensors"])
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged(path, "the list of checksums") from error
    if xxhash.xxh3_64_hexdigest(text.encode()) != of_header:
        raise _damaged(path, "the header")
    return "{" + text.removeprefix(CHECKED), of_tensors


def checksum_of(array: np.ndarray) -> str:
    """XXH3 (64 bits) of dtype, shape and bytes of an array that is C-contiguous, in hexadecimal."""
    # Not a digest of cryptography: it guards against accidents and must cost next to nothing.
    state = xxhash.xxh3_64(f"{array.dtype.str} {array.shape}".encode())
    state.update(array.reshape(-1).view(np.uint8).data)
    return state.hexdigest()


def _damaged(path: StrPath, part: str) -> ValueError:
    return ValueError(
        f"{path}: {part} is not what was written: its checksum differs, so the file was damaged on the disk "
        "or in a copy, or changed by another program. Fetch it again, or delete it and make it again"
    )


def _as_array(name: str, tensor: Any) -> np.ndarray:
    # Duck typing: reading and planning must not load torch.
    if hasattr(tensor, "detach"):
        tensor = tensor.detach().cpu().numpy()
    array = np.asarray(tensor, order="C")
    if array.dtype.newbyteorder("=") not in [np.dtype(dtype) for dtype in DTYPES.values()]:
        raise ValueError(
            f"tensor {name!r} has dtype {array.dtype}, which is not portable; "
            "convert it to a number type, or put it in the header if it is text"
        )
    return np.asarray(array, dtype=array.dtype.newbyteorder("<"), order="C")


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{value!r} is of type {type(value).__name__}")


M = TypeVar("M", bound="torch.nn.Module")


def restore_module(module: M, tensors: Mapping[str, np.ndarray], path: StrPath) -> M:
    """Load the ``tensors`` read from ``path`` into ``module`` and return it in evaluation mode.

    Raises:
        ValueError: the tensors are not those of this module.
    """
    import torch  # here, because reading and planning must not load torch

    try:
        module.load_state_dict({name: torch.as_tensor(np.array(value)) for name, value in tensors.items()})
    except RuntimeError as error:
        first = str(error).splitlines()[-1].strip()
        raise ValueError(
            f"{path}: weights of another layout ({first}); the file was made by other code. Delete it and "
            "make it again"
        ) from error
    return module.eval()
