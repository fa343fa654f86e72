"""Read the intact messages of an MCAP file that may be damaged, and report what is lost.

A log is cut short when its recorder is killed, and then has no index. So the index is never used: records
are read from the start up to the first incomplete one; of a cut chunk, whatever can be decompressed is read.

Source: MCAP format specification, https://mcap.dev/spec
"""

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BufferedReader, BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")  # type, and number of bytes that follow
CONTENT = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)
PARSERS: dict[int, Callable[[ReadDataStream], Schema | Channel | Chunk]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
}
PARTS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "lz4": lambda data: lz4.frame.LZ4FrameDecompressor().decompress(data),
    "zstd": lambda data: zstandard.ZstdDecompressor().decompressobj().decompress(data),
}
"""Decompressors by codec: return as much as a truncated stream gives."""


def read_whole_messages(
    path: str | os.PathLike[str], losses: list[str]
) -> Iterator[tuple[Schema | None, Channel, Message]]:
    """Yield every intact message with its channel and schema, in file order.

    Each loss adds a sentence to ``losses``: bytes after the last intact record, and chunks whose checksum
    does not match.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is no MCAP, or is compressed with an unknown codec.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{path}: it does not begin as an MCAP file does; check which file was given")
        size = path.stat().st_size
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        # The summary repeats schemas and channels, so a topic survives the loss of their chunk.
        for record in _walk(file, len(MAGIC), size, (Opcode.SCHEMA, Opcode.CHANNEL), []):
            _learn(record, schemas, channels)
        orphans = 0
        for record in _records(path, file, size, losses):
            if not isinstance(record, Message):
                _learn(record, schemas, channels)
            elif record.channel_id in channels:
                channel = channels[record.channel_id]
                yield schemas.get(channel.schema_id), channel, record
            else:
                orphans += 1
        if orphans:
            losses.append(f"{orphans} messages belong to a channel that is lost")


def _learn(record: object, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
    if isinstance(record, Schema):
        schemas[record.id] = record
    elif isinstance(record, Channel):
        channels[record.id] = record


def _records(
    path: Path, file: BufferedReader, size: int, losses: list[str]
) -> Iterator[Schema | Channel | Message]:
    for record in _walk(file, len(MAGIC), size, CONTENT, losses):
        if isinstance(record, _Torn):
            yield from _whole_part(record, losses)
        elif not isinstance(record, Chunk):
            yield record
        elif record.compression not in PARTS:
            raise ValueError(
                f"{path}: compressed with {record.compression!r}; those read are lz4, zstd and none. "
                "Rewrite it with `mcap compress`"
            )
        else:
            try:
                inner = breakup_chunk(record, validate_crc=True)
            except Exception as error:  # every codec raises its own errors
                span_s = (record.message_end_time - record.message_start_time) / 1e9
                losses.append(f"a chunk of {span_s:.3f} s is damaged ({error})")
                continue
            yield from (each for each in inner if isinstance(each, Schema | Channel | Message))


def _whole_part(chunk: "_Torn", losses: list[str]) -> Iterator[Schema | Channel | Message]:
    """Records of a chunk that is cut short, as far as its codec can decompress."""
    try:
        # A truncated stream gives short reads; the data end there.
        start = Chunk.read(ReadDataStream(BytesIO(chunk.content)))
        data = PARTS[start.compression](start.data)
    except Exception as error:  # cut within its head, or within the first block of its codec
        losses.append(f"nothing of the last chunk can be read ({type(error).__name__})")
        return
    count = 0
    for record in _walk(BytesIO(data), 0, len(data), CONTENT, []):
        if isinstance(record, Schema | Channel | Message):
            count += isinstance(record, Message)
            yield record
    losses.append(f"{count} messages of the last chunk, which is cut short, are whole")


@dataclass(frozen=True)
class _Torn:
    """The start of a chunk that the end of the file cuts short."""

    content: bytes


def _walk(
    file: BufferedReader | BytesIO, position: int, size: int, wanted: tuple[Opcode, ...], losses: list[str]
) -> Iterator[Schema | Channel | Message | Chunk | _Torn]:
    """Records outside chunks, from ``position`` up to the footer or the first incomplete one."""
    opcode = 0
    while opcode != Opcode.FOOTER:
        file.seek(position)
        head = file.read(RECORD_HEAD.size)
        opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (0, 0)
        # Zero is no record type: it pads a preallocated file.
        if opcode == 0 or position + RECORD_HEAD.size + length > size:
            losses.append(
                f"the file ends without its footer, {size - position} bytes after its last whole record"
            )
            if opcode == Opcode.CHUNK in wanted:
                yield _Torn(file.read())
            return
        if opcode in wanted:
            stream = ReadDataStream(BytesIO(file.read(length)))
            yield Message.read(stream, length) if opcode == Opcode.MESSAGE else PARSERS[opcode](stream)
        position += RECORD_HEAD.size + length
