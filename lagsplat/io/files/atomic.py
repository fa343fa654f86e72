"""Files that are either whole or absent.

A run may be killed at any moment, and what it leaves behind is read by the next one. So nothing is written in
place: the content goes to a hidden sibling first, is forced to the disk, and is then renamed over the
target, which the operating system does in one step.
"""

import errno
import hashlib
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def replace_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary sibling of ``path`` to write to; renamed over ``path`` when the block ends without error.

    On any error the temporary file is removed and what stood at ``path`` before is left as it was. The
    sibling keeps the suffix of ``path``, because some writers choose their format by it. Missing folders are
    made.

    Raises:
        OSError: the disk is full or the folder cannot be written; the message names the target.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(6)}{target.suffix}")
    try:
        temporary.touch()
        mode = temporary.stat().st_mode  # the user's umask; some writers make their files private
        yield temporary
        temporary.chmod(mode)
        _flush(temporary)
        os.replace(temporary, target)
        _flush(target.parent)
    except Exception as error:
        reason = _explain(error)
        if reason is None:
            raise
        raise OSError(f"{target} was not written: {reason}. Nothing was changed there.") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write ``text`` as UTF-8 to ``path``, whole or not at all."""
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


def _explain(error: Exception) -> str | None:
    # Some writers are compiled and report the operating system's error as text only, hence the search in
    # words.
    number = getattr(error, "errno", None)
    words = str(error).lower()
    if number in (errno.ENOSPC, errno.EDQUOT) or "no space left" in words or "quota exceeded" in words:
        return "the disk or quota is full; free some space and run again"
    if number == errno.EFBIG or "file too large" in words:
        return "the file would exceed the largest size allowed here (see `ulimit -f`)"
    return None


def sha256_of(path: str | os.PathLike[str]) -> str:
    """SHA-256 of the file at ``path``, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of_arrays(*arrays: np.ndarray) -> str:
    """SHA-256 of the arrays' bytes, one after the other, in hexadecimal."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
