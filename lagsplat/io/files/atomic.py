"""Write files atomically (text, JSON, CSV), read them, and compute checksums; loads neither pandas nor torch.

A run may be killed at any moment, and the next one reads what it leaves. So content goes to a hidden file
beside the target, is forced to the disk and renamed over the target, which is one step.
"""

import csv
import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

StrPath = str | os.PathLike[str]


REASONS = {
    errno.ENOSPC: "the disk or quota is full; free some space and run again",
    errno.EDQUOT: "the disk or quota is full; free some space and run again",
    errno.EFBIG: "the file would exceed the largest size allowed here (see `ulimit -f`)",
    errno.EIO: "the disk or its network fails; write to another one",
    errno.EROFS: "its file system is read-only; write to another folder, or mount it for writing",
    errno.EACCES: "its folder may not be written by this user; write to another one, or change the rights",
    errno.EPERM: "its folder may not be written by this user; write to another one, or change the rights",
    errno.ENOTDIR: "a file stands where a folder is needed; move it away or write to another folder",
    errno.EEXIST: "a file stands where a folder is needed; move it away or write to another folder",
    errno.ENAMETOOLONG: "its name is too long for the file system; choose a shorter one",
}
"""Why a file cannot be written, by the number of the operating system's error, and what to do."""


@contextmanager
def replace_atomically(path: StrPath) -> Iterator[Path]:
    """Yield a temporary sibling of ``path`` to write to; rename it to ``path`` if the block succeeds.

    On an error the temporary file is removed and ``path`` is unchanged. The sibling keeps the suffix of
    ``path``, because some writers choose their format by it. Missing folders are created.

    Raises:
        OSError: the file cannot be written; the message names the target, the reason and what to do.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(6)}{target.suffix}")
    outcome = f"{target} was not written: {{}}. Nothing was changed there."
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
        mode = temporary.stat().st_mode  # the user's umask; some writers make their files private
        yield temporary
        temporary.chmod(mode)
        _flush(temporary)
        os.replace(temporary, target)
        outcome = f"{target} was written, but may be lost if the machine stops now: {{}}."
        _flush(target.parent)
    except Exception as error:
        if (number := _errno_of(error)) is None:
            raise
        kind = type(error) if isinstance(error, OSError) else OSError
        raise kind(outcome.format(REASONS[number])) from error
    finally:
        with suppress(OSError):  # what cannot be written may not be removed either
            temporary.unlink(missing_ok=True)


def _errno_of(error: Exception) -> int | None:
    """Which of `REASONS` an error has; compiled writers tell it as text alone."""
    if (number := getattr(error, "errno", None)) in REASONS:
        return number
    words = str(error).lower()
    return next((each for each in REASONS if os.strerror(each).lower() in words), None)


def copy_file(source: StrPath, target: StrPath) -> None:
    """Copy the content of a file, atomically."""
    with replace_atomically(target) as temporary:
        shutil.copyfile(source, temporary)


def write_text(path: StrPath, text: str) -> None:
    """Write ``text`` as UTF-8 to ``path``, atomically."""
    with replace_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def _flush(path: Path) -> None:
    # A rename may reach the disk before the bytes it points to; without this a power cut leaves an empty
    # file. Some network file systems refuse to sync a folder, which loses nothing but that guarantee.
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)


def sha256_of(path: StrPath) -> str:
    """SHA-256 of the file at ``path``, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of_arrays(*arrays: np.ndarray) -> str:
    """SHA-256 of the concatenated bytes of the arrays, in hexadecimal."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def save_csv(path: StrPath, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows under the column names of the first row; None is an empty cell.

    Raises:
        ValueError: there is no row, or a row has a column that the first row lacks.
    """
    if not rows:
        raise ValueError(f"{path}: a table without a row has no columns")
    with replace_atomically(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def save_json(path: StrPath, content: Mapping[str, Any]) -> None:
    """Write plain data, indented, so that two runs can be compared line by line."""
    write_text(path, json.dumps(content, indent=1) + "\n")


def load_json(path: StrPath) -> dict[str, Any]:
    """Read plain data written by `save_json`.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is not JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: not JSON ({error}); delete it and run again") from error
