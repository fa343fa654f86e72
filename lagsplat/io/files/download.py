"""Resumable downloads, and members of a public zip archive checked by their SHA-256.

Content goes to a sibling with the suffix ``.part``, which the next call continues after an interruption.
Only a complete file gets the final name.
"""

import fcntl
import os
import re
import shutil
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from time import sleep
from urllib.parse import urlsplit

import requests
from tqdm import tqdm

from lagsplat.io.config import ArchiveConfig
from lagsplat.io.files.atomic import StrPath, replace_atomically, sha256_of

CHUNK_BYTES = 2**16
ATTEMPTS = 6
TIMEOUT_S = 30.0
WORTH_RETRYING = (408, 425, 429)  # HTTP errors that mean "try again later"


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
        raise ValueError(f"recording.member is {member!r}; archive has {sorted(archive.member_sha256)}")
    folder, expected = Path(archive.folder).expanduser(), archive.member_sha256[member]
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / PurePosixPath(member).name
    # Two jobs of a workflow may need members of the same archive at the same time.
    with open(folder / ".lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if target.exists():
            _check_existing(target, expected)
        else:
            source = folder / PurePosixPath(urlsplit(archive.url).path).name
            download(archive.url, source, sha256=archive.archive_sha256)
            _extract(source, member, target, expected)
    return target


def _check_existing(path: Path, expected: str | None) -> None:
    if expected is not None and (digest := sha256_of(path)) != expected:
        raise FileExistsError(
            f"{path}: SHA-256 is {digest}, expected {expected}. It is left as it is; move it away or "
            "delete it and run again, or name it with recording.path if it is meant to differ"
        )


def _extract(source: Path, member: str, target: Path, expected: str) -> None:
    try:
        with zipfile.ZipFile(source) as archive:
            if member not in archive.namelist():
                members = archive.namelist()[:20]
                raise ValueError(f"{source}: no member {member!r}, only {members}; check recording.archive")
            _require_space(target, archive.getinfo(member).file_size)
            with replace_atomically(target) as temporary:
                with archive.open(member) as stream, open(temporary, "wb") as file:
                    shutil.copyfileobj(stream, file)
                if (digest := sha256_of(temporary)) != expected:
                    raise ValueError(
                        f"{source}: SHA-256 of member {member!r} is {digest}, expected {expected}. Delete "
                        "the archive and run again; if it recurs, the publisher has changed it"
                    )
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ValueError(f"{source}: damaged ({error}); delete it and run again") from error


def _require_space(path: Path, needed: int) -> None:
    free = shutil.disk_usage(path.parent).free
    if needed > free:
        raise OSError(f"{path}: needs {needed} bytes, but the disk has {free} free; make room")


def download(url: str, path: StrPath, *, sha256: str | None) -> Path:
    """Download ``url`` to ``path``, resuming an earlier call, and check it; return ``path``.

    A file already at ``path`` is never changed: it is returned if ``sha256`` matches or is None, which checks
    only the length. A lost connection is retried after 1, 2, 4, ... seconds; any progress resets the
    count. If the server cannot resume, the download restarts.

    Raises:
        ValueError: the SHA-256 differs; the content is removed, because resuming would not help.
        FileExistsError: a file of another SHA-256 is at ``path``.
        ConnectionError: the server refuses or the connection keeps failing; the part is kept.
        OSError: the disk has less space than the server announces; the part is kept.
    """
    path = Path(path)
    if path.exists():
        _check_existing(path, sha256)
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    _fetch_patiently(url, part)
    if sha256 is not None and (digest := sha256_of(part)) != sha256:
        part.unlink()
        raise ValueError(
            f"{path}: SHA-256 of {url} is {digest}, expected {sha256}. What came is damaged and was removed; "
            "run again. If it recurs, the publisher has changed the file"
        )
    os.replace(part, path)
    return path


def _fetch_patiently(url: str, part: Path) -> None:
    failures, reached = 0, _size(part)
    while True:
        try:
            _fetch_rest(url, part)
            return
        except (requests.RequestException, EOFError) as error:
            failures = 1 if _size(part) > reached else failures + 1
            # The largest size so far; otherwise a server that restarts each time would loop for ever.
            reached = max(reached, _size(part))
            if failures >= ATTEMPTS or not _may_pass(error):
                raise ConnectionError(
                    f"{url}: {error} ({failures} attempts without progress). {_size(part)} bytes are kept in "
                    f"{part}; run again to go on, or fetch the file by hand to {part.with_suffix('')}"
                ) from error
            sleep(2.0 ** (failures - 1))


def _may_pass(error: Exception) -> bool:
    if isinstance(error, requests.HTTPError):
        return error.response.status_code >= 500 or error.response.status_code in WORTH_RETRYING
    broken = (requests.ConnectionError, requests.Timeout, requests.exceptions.ChunkedEncodingError, EOFError)
    return isinstance(error, broken)


def _fetch_rest(url: str, part: Path) -> None:
    """Append to ``part`` the rest of ``url``."""
    start = _size(part)
    # With compressed transfer, byte positions would not match the file.
    headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={start}-"} if start else {})
    with requests.get(url, headers=headers, stream=True, timeout=TIMEOUT_S) as response:
        begin, total = _range(response)
        if response.status_code == requests.codes.requested_range_not_satisfiable:
            if total == start:
                return
            part.unlink()
            raise EOFError(f"the part had {start} bytes, but the file has {total}; starting again")
        response.raise_for_status()
        if begin not in (0, start):
            raise EOFError(f"asked for content from byte {start}, got it from byte {begin}")
        _require_space(part, (total or 0) - begin)
        # disable=None: no bar outside a terminal, as in a log file.
        bar = tqdm(total=total, initial=begin, unit="B", unit_scale=True, desc=part.stem, disable=None)
        with bar, open(part, "ab" if begin else "wb") as file:
            for chunk in response.iter_content(CHUNK_BYTES):
                file.write(chunk)
                bar.update(len(chunk))
            file.flush()
            os.fsync(file.fileno())
    if total is not None and _size(part) != total:
        raise EOFError(f"{_size(part)} of {total} bytes came")


def _range(response: requests.Response) -> tuple[int, int | None]:
    """First byte of the content of ``response`` within the file, and the file's length, if known."""
    match = re.fullmatch(r"bytes (?:(\d+)-\d+|\*)/(\d+|\*)", response.headers.get("Content-Range", ""))
    if match:
        begin, total = match.groups()
        return int(begin or 0), None if total == "*" else int(total)
    length = response.headers.get("Content-Length")
    return 0, int(length) if length and response.ok else None


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
