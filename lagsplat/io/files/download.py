"""Resumable downloads, and members of a public zip archive checked by their SHA-256.

Content goes to a sibling with the suffix ``.part``, which the next call continues after an interruption.
Only a complete file gets the final name.
"""

import fcntl
import hashlib
import os
import re
import shutil
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

import requests
from tqdm import tqdm

from lagsplat.io.config import ArchiveConfig
from lagsplat.io.files.atomic import replace_atomically, sha256_of

COPY_BYTES = 2**20


def fetch_member(archive: ArchiveConfig, member: str) -> Path:
    """Return the extracted ``member`` of ``archive``, in ``archive.folder``; download it if needed.

    A member with the right SHA-256 is returned without network access. Otherwise the archive is downloaded,
    unless it is present, and kept: you may delete it once the members are extracted, or put it there
    yourself. Processes that need the same folder wait for one another.

    Raises:
        ValueError: the archive does not list the member, is damaged, or the member's SHA-256 differs.
        FileExistsError, ConnectionError, OSError: as `download`; or the disk has too little space.
    """
    if member not in archive.member_sha256:
        raise ValueError(
            f"recording.member is {member!r}; archive.member_sha256 knows {sorted(archive.member_sha256)}"
        )
    folder = Path(archive.folder).expanduser()
    folder.mkdir(parents=True, exist_ok=True)
    expected = archive.member_sha256[member]
    target = folder / PurePosixPath(member).name
    with _alone_in(folder):
        if target.exists():
            _check_extracted(target, expected)
            return target
        source = folder / PurePosixPath(urlsplit(archive.url).path).name
        download(archive.url, source, sha256=archive.archive_sha256)
        _extract(source, member, target, expected)
    return target


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    # Two jobs of a workflow may need members of the same archive at the same time.
    with open(folder / ".lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _check_extracted(target: Path, expected: str) -> None:
    found = sha256_of(target)
    if found != expected:
        raise FileExistsError(
            f"{target}: SHA-256 is {found}, expected {expected}. It is left as it is; delete it and "
            "run again, or name it with recording.path if it is meant to differ"
        )


def _extract(source: Path, member: str, target: Path, expected: str) -> None:
    try:
        with zipfile.ZipFile(source) as archive:
            if member not in archive.namelist():
                raise ValueError(
                    f"{source}: no member {member!r}, only {archive.namelist()[:20]}; check recording.archive"
                )
            _check_space(target, archive.getinfo(member).file_size)
            with archive.open(member) as stream, replace_atomically(target) as temporary:
                digest = hashlib.sha256()
                with open(temporary, "wb") as file:
                    while block := stream.read(COPY_BYTES):
                        file.write(block)
                        digest.update(block)
                if digest.hexdigest() != expected:
                    raise ValueError(
                        f"{source}: SHA-256 of member {member!r} is {digest.hexdigest()}, "
                        f"expected {expected}. Delete the archive and run again; if it recurs, "
                        "the publisher has changed it"
                    )
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ValueError(f"{source}: damaged ({error}); delete it and run again") from error


def _check_space(target: Path, needed: int) -> None:
    free = shutil.disk_usage(os.path.dirname(target)).free
    if needed > free:
        raise OSError(f"{target}: needs {needed} bytes, but the disk has {free} free; make room")


CHUNK_BYTES = 2**16
ATTEMPTS = 6
TIMEOUT_S = 30.0
WORTH_RETRYING = (408, 425, 429)  # HTTP errors that mean "try again later"


def download(
    url: str,
    path: str | os.PathLike[str],
    *,
    sha256: str | None,
    wait: Callable[[float], object] = time.sleep,
) -> Path:
    """Download ``url`` to ``path``, resuming an earlier call, and check it; return ``path``.

    A file already at ``path`` is never changed: it is returned if ``sha256`` matches or is None. A lost
    connection is retried after 1, 2, 4, ... seconds; any progress resets the count. If the server cannot
    resume, the download restarts.

    Args:
        url: What to download.
        path: Where to put it.
        sha256: Expected digest; None checks only the length.
        wait: Called with the seconds between attempts.

    Raises:
        ValueError: the SHA-256 differs; the content is removed, because resuming would not help.
        FileExistsError: a file of another SHA-256 is at ``path``.
        ConnectionError: the server refuses or the connection keeps failing; the part is kept.
        OSError: the disk has less space than the server announces; the part is kept.
    """
    path = Path(path)
    if path.exists():
        return _accept_existing(path, sha256)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    found = _fetch_patiently(url, part, wait=wait)
    if sha256 is not None and found != sha256:
        part.unlink()
        raise ValueError(
            f"{path}: SHA-256 of {url} is {found}, expected {sha256}. What came is damaged and was removed; "
            "run again. If it recurs, the publisher has changed the file"
        )
    os.replace(part, path)
    return path


def _accept_existing(path: Path, sha256: str | None) -> Path:
    if sha256 is not None and (found := sha256_of(path)) != sha256:
        raise FileExistsError(
            f"{path}: already there with SHA-256 {found}, expected {sha256}. It is left as it is; "
            "move it away and run again"
        )
    return path


def _fetch_patiently(url: str, part: Path, *, wait: Callable[[float], object]) -> str:
    failures, reached = 0, _size(part)
    while True:
        try:
            return _fetch_rest(url, part)
        except (requests.RequestException, EOFError) as error:
            failures = 1 if _size(part) > reached else failures + 1
            # The largest size so far; otherwise a server that restarts each time would loop for ever.
            reached = max(reached, _size(part))
            if failures >= ATTEMPTS or not _may_pass(error):
                raise ConnectionError(
                    f"{url}: {error} ({failures} attempts without progress). {_size(part)} bytes are kept in "
                    f"{part}; run again to go on, or fetch the file by hand and put it there "
                    "without the suffix .part"
                ) from error
            wait(2.0 ** (failures - 1))


def _may_pass(error: Exception) -> bool:
    if isinstance(error, requests.HTTPError):
        return error.response.status_code >= 500 or error.response.status_code in WORTH_RETRYING
    broken = (requests.ConnectionError, requests.Timeout, requests.exceptions.ChunkedEncodingError, EOFError)
    return isinstance(error, broken)


def _fetch_rest(url: str, part: Path) -> str:
    """Append to ``part`` the rest of ``url``; return the SHA-256 of the whole."""
    start = _size(part)
    # With compressed transfer, byte positions would not match the file.
    headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={start}-"} if start else {})
    with requests.get(url, headers=headers, stream=True, timeout=TIMEOUT_S) as response:
        begin, total = _range(response)
        if response.status_code == requests.codes.requested_range_not_satisfiable:
            if total == start:
                return sha256_of(part)
            part.unlink()
            raise EOFError(f"the part had {start} bytes, but the file has {total}; starting again")
        response.raise_for_status()
        if begin not in (0, start):
            raise EOFError(f"asked for content from byte {start}, got it from byte {begin}")
        _check_room(part, total, begin)
        return _append(response, part, begin=begin, total=total)


def _append(response: requests.Response, part: Path, *, begin: int, total: int | None) -> str:
    digest = hashlib.sha256()
    with open(part, "r+b" if begin else "wb") as file:
        while begin and (block := file.read(CHUNK_BYTES)):
            digest.update(block)
        # disable=None: no bar outside a terminal, as in a log file.
        with tqdm(total=total, initial=begin, unit="B", unit_scale=True, desc=part.stem, disable=None) as bar:
            for chunk in response.iter_content(CHUNK_BYTES):
                file.write(chunk)
                digest.update(chunk)
                bar.update(len(chunk))
        file.flush()
        os.fsync(file.fileno())
        size = file.tell()
    if total is not None and size != total:
        raise EOFError(f"{size} of {total} bytes came")
    return digest.hexdigest()


def _range(response: requests.Response) -> tuple[int, int | None]:
    """First byte of the content of ``response`` within the file, and the file's length, if known."""
    match = re.fullmatch(r"bytes (?:(\d+)-\d+|\*)/(\d+|\*)", response.headers.get("Content-Range", ""))
    if match:
        begin, total = match.groups()
        return int(begin or 0), None if total == "*" else int(total)
    length = response.headers.get("Content-Length")
    return 0, int(length) if length and response.ok else None


def _check_room(part: Path, total: int | None, begin: int) -> None:
    free = shutil.disk_usage(part.parent).free
    if total is not None and total - begin > free:
        raise OSError(
            f"{part}: {total - begin} bytes are to come, but the disk has {free} free; make room, or choose "
            "another folder"
        )


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
