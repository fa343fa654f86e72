"""Members of a public zip archive: downloaded once, extracted once, checked by their SHA-256."""

import fcntl
import hashlib
import os
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

from lagsplat.io.atomic import replacing
from lagsplat.io.checksum import sha256_of
from lagsplat.io.config import ArchiveConfig
from lagsplat.io.download import download

CHUNK_BYTES = 2**20


def fetch_member(archive: ArchiveConfig, member: str) -> Path:
    """The extracted ``member`` of ``archive``, in ``archive.folder``.

    A member that is there and has the right SHA-256 is returned without touching the network. Otherwise the
    archive is downloaded, unless it is there too, and stays: it may be deleted by hand once the members are
    extracted, or put there by hand. Processes that need the same folder wait for one another.

    Raises:
        ValueError: the archive does not list the member, is damaged, or the member's SHA-256 differs.
        FileExistsError, ConnectionError, OSError: as `lagsplat.io.download.download`; or too little room.
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
            _check_room(target, archive.getinfo(member).file_size)
            with archive.open(member) as stream, replacing(target) as temporary:
                digest = hashlib.sha256()
                with open(temporary, "wb") as file:
                    while block := stream.read(CHUNK_BYTES):
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


def _check_room(target: Path, needed: int) -> None:
    free = shutil.disk_usage(os.path.dirname(target)).free
    if needed > free:
        raise OSError(f"{target}: needs {needed} bytes, but the disk has {free} free; make room")
