"""Checksums of files and of arrays.

Members of a public zip archive: downloaded once, extracted once, checked by their SHA-256.

Downloads that go on where they stopped and are checked.

The content collects in a sibling with the suffix ``.part``, which an interruption leaves for the next call.
Only what is whole gets the final name.
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
    """The extracted ``member`` of ``archive``, in ``archive.folder``.

    A member that is there and has the right SHA-256 is returned without touching the network. Otherwise the
    archive is downloaded, unless it is there too, and stays: it may be deleted by hand once the members are
    extracted, or put there by hand. Processes that need the same folder wait for one another.

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
    # Two jobs of one workflow may want two members of one archive at the same time.
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
WORTH_RETRYING = (408, 425, 429)  # the refusals that mean "later"


def download(
    url: str,
    path: str | os.PathLike[str],
    *,
    sha256: str | None,
    wait: Callable[[float], object] = time.sleep,
) -> Path:
    """Fetch ``url`` to ``path``, from where an earlier call stopped, and check it; returns ``path``.

    A file already at ``path`` is never changed: with the right ``sha256`` it is the answer, without
    ``sha256`` it is taken as it is, and with another sum it is an error. A lost connection is tried again
    after 1, 2, 4, ... seconds, spent by calling ``wait``; whenever content was gained the count of attempts
    starts anew. Where the server cannot continue, everything is fetched again. ``sha256`` None leaves the
    length as the only check.

    Raises:
        ValueError: the SHA-256 differs; what came is removed, because continuing it could not help.
        FileExistsError: a file of another SHA-256 is at ``path``.
        ConnectionError: the server refuses or the connection keeps failing; the part is kept.
        OSError: the disk has less room than the server announces; the part is kept.
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
            # The best so far, or a server that starts over each time could keep this going for ever.
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
    """Append to ``part`` what it lacks of ``url``; the SHA-256 of the whole.

    Raises:
        requests.RequestException, EOFError: less came than announced, or nothing; what came is in ``part``.
    """
    start = _size(part)
    # Compression on the way would make byte positions meaningless.
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
        # disable=None: no bar where nobody watches, as in a log file.
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
    """Where the content of ``response`` begins in the file, and how long the file is, if known."""
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
