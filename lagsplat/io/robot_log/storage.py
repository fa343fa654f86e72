"""Read the messages of a robot's log, whatever stores them: an MCAP file, an SQLite file, or a ROS 2 bag.

A bag is a folder that a recorder made: ``metadata.yaml`` and a file, or several after a split. Its messages
or its files may be compressed by zstd. What is missing or damaged is reported and the rest is read, so that
a recorder that was killed loses its last messages only.
"""

import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import yaml
import zstandard
from mcap.records import Channel, Message, Schema
from mcap.well_known import MessageEncoding

from lagsplat.io.files.atomic import StrPath, sha256_of
from lagsplat.io.robot_log.recovery import read_whole_messages
from lagsplat.io.robot_log.sqlite_storage import read_sqlite_messages
from lagsplat.provenance import sha256_hex

Messages = Iterator[tuple[Schema | None, Channel, Message]]
READERS: dict[str, Callable[[StrPath, list[str]], Messages]] = {
    ".mcap": read_whole_messages,
    ".db3": read_sqlite_messages,
}
"""Suffix of each storage, and what reads its messages."""
ZSTD = ".zstd"
METADATA = "metadata.yaml"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # a message in CDR begins with a zero byte
PIECE_BYTES = 1 << 20  # decompressed at once


def is_log(path: StrPath) -> bool:
    """Whether ``path`` is named as an MCAP or SQLite file is, or is the folder of a bag."""
    path = Path(path)
    return _storage_of(path) in READERS or bool(path.is_dir() and _files_inside(path))


def list_log_files(path: StrPath, losses: list[str] | None = None) -> tuple[Path, ...]:
    """The files of a log in the order of their messages: the file itself, or the files of a bag.

    The order is that of ``metadata.yaml``, or of the names where it is missing or damaged, which adds a
    sentence to ``losses``; so does a file that it names and that is missing.

    Raises:
        FileNotFoundError: nothing is at ``path``, or no file of the bag is there.
    """
    path, losses = Path(path), [] if losses is None else losses
    if not path.is_dir():
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such file; check the path")
        return (path,)
    inside, named = _files_inside(path), _read_metadata(path, losses)
    missing = [name for name in named if not (path / name).is_file()]
    losses += [f"{name} is missing, which {METADATA} names" for name in missing]
    files = [path / name for name in named if name not in missing] or inside
    if not files:
        raise FileNotFoundError(
            f"{path}: no file of this bag is there ({', '.join(named) or ' or '.join(READERS)}); copy the "
            "whole folder of the bag"
        )
    return tuple(files)


def read_messages(path: StrPath, losses: list[str]) -> Messages:
    """Yield every intact message of a log with its channel and schema, in the order of the files.

    Each loss adds a sentence to ``losses``, which names the file where there are several.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: no file is what its name says, or a file is compressed in an unknown way.
    """
    files = list_log_files(path, losses)
    refused: list[ValueError] = []
    for file in files:
        found: list[str] = []
        try:
            yield from _read_file(file, found)
        except ValueError as error:
            if len(files) == 1:
                raise
            refused.append(error)
            found.append(str(error).removeprefix(f"{file}: "))
        losses += found if len(files) == 1 else [f"{file.name}: {loss}" for loss in found]
    if len(refused) == len(files):
        raise refused[0]


def hash_log(path: StrPath) -> str:
    """SHA-256 of a log's file, or of the hashes of a bag's files, in hexadecimal."""
    digests = [sha256_of(file) for file in list_log_files(path)]
    return digests[0] if len(digests) == 1 else sha256_hex("".join(digests).encode())


def _storage_of(path: Path) -> str:
    return Path(path.name.lower().removesuffix(ZSTD)).suffix


def _files_inside(folder: Path) -> list[Path]:
    """The files of a bag in a folder, in the order of their numbers; none if the folder is no bag."""
    files = [file for file in folder.iterdir() if file.is_file() and _storage_of(file) in READERS]
    if not (folder / METADATA).is_file():
        # Without metadata, MCAP files may be logs that have nothing to do with one another.
        own = re.compile(re.escape(folder.name) + r"(_\d+)?\.mcap", re.IGNORECASE)
        files = [
            file
            for file in files
            if _storage_of(file) == ".db3" or own.fullmatch(file.name.removesuffix(ZSTD))
        ]
    numbers = {file: [int(part) for part in re.findall(r"\d+", file.name)] for file in files}
    return sorted(files, key=lambda file: (numbers[file], file.name))


def _read_metadata(folder: Path, losses: list[str]) -> list[str]:
    """Names of the files that ``metadata.yaml`` lists, in order; none if it cannot be read."""
    order = "the files are taken in the order of their numbers"
    try:
        content = yaml.safe_load((folder / METADATA).read_text(encoding="utf-8"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        return [Path(str(name)).name for name in names]
    except FileNotFoundError:
        losses.append(f"{METADATA} is missing, as where a recorder was killed; {order}")
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        losses.append(f"{METADATA} cannot be read ({reason}); {order}")
    return []


def _read_file(path: Path, losses: list[str]) -> Messages:
    storage = _storage_of(path)
    if storage not in READERS:
        known = f"a log ends in {' or '.join(READERS)}, and in {ZSTD} after that where it is compressed"
        raise ValueError(f"{path}: {path.suffix or 'a name without suffix'} is not read; {known}")
    broken = 0
    with _decompressed(path, losses) as plain:
        try:
            for schema, channel, message in READERS[storage](plain, losses):
                packed = channel.message_encoding == MessageEncoding.CDR and message.data[:4] == ZSTD_MAGIC
                try:
                    unpacked = replace(message, data=_decompress(message.data)) if packed else message
                except zstandard.ZstdError:
                    broken += 1
                else:
                    yield schema, channel, unpacked
        except ValueError as error:
            raise ValueError(str(error).replace(str(plain), str(path))) from error
    if broken:
        losses.append(f"{broken} compressed messages are damaged and left out")


def _decompress(data: bytes) -> bytes:
    """A compressed message, whether or not its length stands before it."""
    decompressor = zstandard.ZstdDecompressor().decompressobj()
    content = decompressor.decompress(data)
    if not decompressor.eof:
        raise zstandard.ZstdError("the message is cut short")
    return content


@contextmanager
def _decompressed(path: Path, losses: list[str]) -> Iterator[Path]:
    """The file itself, or a temporary one with as much of its content as can be decompressed."""
    if path.suffix.lower() != ZSTD:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / path.stem
        decompressor = zstandard.ZstdDecompressor().decompressobj()
        with path.open("rb") as packed, plain.open("wb") as file:
            try:
                while (piece := packed.read(PIECE_BYTES)) and not decompressor.eof:
                    file.write(decompressor.decompress(piece))
            except zstandard.ZstdError as error:
                losses.append(f"the compressed file is damaged ({error})")
            else:
                if not decompressor.eof:
                    losses.append("the compressed file is cut short")
            if not file.tell():
                raise ValueError(f"{path}: zstd can decompress nothing of it; copy or record it again")
        yield plain
